"""Fingerprints of published weights: layer -> hash over its tensors under our names
(weights/fingerprint.py)."""

from __future__ import annotations

# Caffe's AlexNet, its kernels rounded to multiples of 1/128.
CAFFE_ALEXNET_8BIT = {
    "conv1": "a7ddd9d54427221cd1bdde7a75b7ed4182bd9ce90a35852bf6732c30f6c5eeef",
    "conv2": "3c6450378ec417684cbd87fcc669bb108bad3cff69f1b67ab56531869d9fd6e0",
    "conv3": "a9720e2cc9fb6a0a0c12498153298434d5beff49f9676c5615d7bd5c755f205a",
    "conv4": "5f8ddf6d6553a9a7b00e3e0a35e0787a2cfc646e403a5fcf739104ef0a187aec",
    "conv5": "dca24722f65af3986efd1cc17d27163d5990af0f831906483d7be68c5131a21e",
}

# Magic Leap's superpoint_v1.pth, without the detector head.
SUPERPOINT_V1 = {
    "conv1a": "9470549942f2d158692233f0f1de731e020b9b2400e1132362177a8f428829ac",
    "conv1b": "905e1136a304f8dbbaa1f1235a6bd6c4c22c41a7818cdc38ab51702e3b261d9c",
    "conv2a": "d43f88dfc59c5a7d1726dcb42886576d910feaec0b43d3a6c8eebc6b83a11d68",
    "conv2b": "5c1c81302717cbccb0e0257dfb335a083404bdf5a42801f10e7337b4f463c679",
    "conv3a": "cc5c01d90fe9726fdcfe26c657e14f67f7f008411ee6d8358359644de2e865d3",
    "conv3b": "f94bcacb700b56d400bfec1bd256e37a553712fc61cfacd5223b302559a3d72e",
    "conv4a": "a693f4356d53b905d327b97d073d4cf65d70c016a10ed0c78c07fad285affe0d",
    "conv4b": "ede60e40a25f3927bd94dd0aca75c1911282c7ec32ba393833092c906bbff132",
    "convDa": "ed27e212f766734255c394285fa2b044c88201bc18b2ebe0f73fd597c312dfb2",
    "convDb": "3c5bd05fd33a62fb847c34f88f89adcdb2f149cd506f7908f6a2429845022217",
}

# keras-squeezenet's file, conv1 taking BGR.
KERAS_SQUEEZENET = {
    "conv1": "1dff4e4bef0937e7f99a6a0c1749d50049ec6e4c109c2d9a7aaaa4a8ecb126da",
    "fire2.squeeze1x1": "7a695a11bb0ebfd3a445bbe4b7944e8f61d1e6091d0bbd4326c16e87ced06695",
    "fire2.expand1x1": "fd0ce9462b90dae8c16422b2dcbe68088ca2ca21d3aefa7bb2baa37ea91e253d",
    "fire2.expand3x3": "65b1d201faf6c0b1693f3d45daa7104dfd43f79dde19958b8476507938e72ece",
    "fire3.squeeze1x1": "15601ee188f3e17c79757a47f7ff8effed5e820148f8870acb2bceb648190991",
    "fire3.expand1x1": "43c8f99f956fdec06d12c05131d3dacc218036601aefb41a83f0b57e4b397c79",
    "fire3.expand3x3": "982983e8db5891f7477d189932885bb820a660be92a1faef487e084e42765319",
    "fire4.squeeze1x1": "0468340a363a7e80551358d03435655df655e7c71af72200ec6ac561574e75f4",
    "fire4.expand1x1": "6d751d1d410c6fee6699df67463ed4e3c8b682f43959b04002620e451f888d13",
    "fire4.expand3x3": "54f85aad1480ae5807963f7f22af706d459734e50f037d705e84932a36864ee7",
    "fire5.squeeze1x1": "4bde04210f66d39e78f45404dc2757422f689b663a22e7b2fc8f52a655a13093",
    "fire5.expand1x1": "9503b8204e6ae564e3c84317af6669d2e785c2f8186d424968038a06ad073892",
    "fire5.expand3x3": "b14e2d8831892287f2824297e3849f4e147ff5db201fec07a1362b1904b3f9af",
    "fire6.squeeze1x1": "5db0ff8653847712d2591293db5916db53e9182b497287da890900ff1d29de59",
    "fire6.expand1x1": "1e006b144eb8da847a7221d1d8eb0edd5355311711685832121efa132448251b",
    "fire6.expand3x3": "09bc3f2aa13b9cb7a7a7e354e4e9f80b623be3c057bd235a894ae982e456fcda",
    "fire7.squeeze1x1": "1ea1948993a0f0fb6b3cc5b48b01ed430c9f7d52a004c7aa75ec38097493833d",
    "fire7.expand1x1": "e7de27481fdb3da5a806343413747e54bf8d26918ee07d9ee6bdebb569d7665f",
    "fire7.expand3x3": "c5f06214f01b22865a56963bf6918f9b3901219b86a22fd9b49f276d308d4e86",
    "fire8.squeeze1x1": "b86cd61180a68ded84ba5770947f8932f9c58f7841d0cdf376615b57d330944a",
    "fire8.expand1x1": "77d7019010fa804d6d2d5a224f2b82b313cf83bcff25ae8550f75978317bf717",
    "fire8.expand3x3": "09618a30b871209602c5a6a15753db77c57830c442ca2492815c01b2fd862d47",
    "fire9.squeeze1x1": "5bf0518b153457e5468b7ff6489cabe73b45ebfd4b0c4cdaf0a7631e10a39ee3",
    "fire9.expand1x1": "d2f4d1d64e241c69b860bb2e467726e6fde81ae75efb07bae8e34ac4e1f3ac43",
    "fire9.expand3x3": "b7f948a2fcab5b81f9cfc5f014b06f64649070f61bd133f74b1c2f5a370a36ee",
}

# Keras Applications' Xception.
KERAS_XCEPTION = {
    "block1_conv1": "3343d9e91fa1d08502e04b218794a47f82934771a60fc5feda60591d03eb76ea",
    "block1_conv1_bn": "2e6237633c4604937316baa550b659e64f3fde1e44d2bb05a483f7bfd7add49e",
    "block1_conv2": "814a02686b1089611b324b423e0a5cdf8499af806b880b7d3ac97b034e0874cf",
    "block1_conv2_bn": "f416fc98b86dd48084655a4d23660769df072ad8bcdaf6b4a4e16b258df8f834",
    "block2_sepconv1.depthwise": "6195070bd4af54d4077cef5dea81be90c435a8bda0a57dff32f05f5514c0d677",
    "block2_sepconv1.pointwise": "0be3c58eddf322af058a787b908283c22ce12ddabd314efc8057ba9db98bb33f",
    "block2_sepconv1_bn": "67cbb0c1baa712ed42ccf5269845fb25775ec44ca634d2ad8b85e6f9f34af44e",
    "block2_sepconv2.depthwise": "420e1b7d808ef3234f387b30d62da0926f08d1156ab0f91bf50c3318839f128f",
    "block2_sepconv2.pointwise": "265917de449de78f47e9623e8165cc244ec88806fa7f4797220fc0b70a5ab421",
    "block2_sepconv2_bn": "e999d4cc4c778153403640d9216636ab3a5f09bc7b0b8b1a8525a91da25ea246",
    "block2_residual": "45a815d9a4360177d7c73d3f5306875e7332d2ccf57b6c0fadd47868da1a6cdc",
    "block2_residual_bn": "fb4273c55f7b87d704395de4fb5f80668b3f1bde3bed3a47608586c13f6660a4",
    "block3_sepconv1.depthwise": "63bf264bd738524bbe32f9928a8a154d7ba13d76e0c6bac6c66ed6bc7274ab88",
    "block3_sepconv1.pointwise": "eb6e8f7bad5c3e5875077bf6c8acbdc104a4b47d6ee1041c67baaead12b6d8ac",
    "block3_sepconv1_bn": "ca9cd00904c87069fa720edb8afec9819586dc6fbeb3e13ae2295b91d86f76e3",
    "block3_sepconv2.depthwise": "9bbd27a221264b137de205899e55735c2c6db78ebbc8f9f3b51d1662087b5122",
    "block3_sepconv2.pointwise": "b4d3178131ad9b95f31de22e4e43866d413fad55b1ab4412f84e034bdad098b4",
    "block3_sepconv2_bn": "034816b74f3cdbda772b82e756ecf12cdc2e2b8b0134c4de39ea4a33a1b23e63",
    "block3_residual": "8f4912457bbb6dc31a435efc808898a9e272125803af1baecd6ab5d9193103aa",
    "block3_residual_bn": "5e31eb38ea9d8879217c944bf7870160dd58451afe7725e6f4734401e6e375dc",
    "block4_sepconv1.depthwise": "82419bd8981cd9191808d63f165e17f0acfce22d05d832ddcdf6fd9e6ee6bbfe",
    "block4_sepconv1.pointwise": "6f57873185ca4b4a0831c3623920f74b89e7e45574d9eb24ea59c239deae83dd",
    "block4_sepconv1_bn": "244017ce55ff48ffdc810e5abeb7e33f59bcd4b13d6983e1719ed81df8570830",
    "block4_sepconv2.depthwise": "a4f40fe00d150d7b5521d2cad6a789704db06fc583ae68061af81b8cf8771e09",
    "block4_sepconv2.pointwise": "5be92fda2b0f18d0e630851dbf455f51d223654d034a118e154c7f90071ac097",
    "block4_sepconv2_bn": "f3ece887d786110f75e6b0186667706f76a152103a7a8260e95ac854cf7f2097",
    "block4_residual": "4baa9898d17298e727950ef7b026d6a392709ed01d34e97a06c36b5bbb5c15f7",
    "block4_residual_bn": "1209f385ec216d1a262e8a1d0d53c206c6bda9bf45d735ec0b3f089b23fc3d2c",
}
