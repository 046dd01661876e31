"""SqueezeNet 1.1.  Iandola et al., "SqueezeNet: AlexNet-level accuracy with 50x fewer parameters", 2016.

Caffe's and torchvision's pools count windows that reach over the image's end; so do these.

Layers: ``conv1``, ``relu1``, ``poolN``, and ``fireN``, the concatenation at the end of a fire module.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch.nn import functional as F

from elf_export.preprocessing import Preprocessing
from elf_export.sources.weights.fit import fit_named
from elf_export.sources.weights.sources import Download

from .parts.architecture import Architecture, Conv, Maps, Part
from .parts.network import Network

# Fire module -> (inputs, channels of the squeeze, of each expansion)
FIRES = {
    2: (64, 16, 64),
    3: (128, 16, 64),
    4: (128, 32, 128),
    5: (256, 32, 128),
    6: (256, 48, 192),
    7: (384, 48, 192),
    8: (384, 64, 256),
    9: (512, 64, 256),
}
POOLED = (3, 5)


def _parts() -> dict[str, Conv]:
    parts = {"conv1": Conv(3, 64, 3, stride=2)}
    for i, (inputs, squeezed, expanded) in FIRES.items():
        parts[f"fire{i}.squeeze1x1"] = Conv(inputs, squeezed, 1)
        parts[f"fire{i}.expand1x1"] = Conv(squeezed, expanded, 1)
        parts[f"fire{i}.expand3x3"] = Conv(squeezed, expanded, 3, padding=1)
    return parts


def forward(part: Part, x: torch.Tensor) -> Maps:
    x = part("conv1", x)
    yield "conv1", x
    x = F.relu(x)
    yield "relu1", x
    x = F.max_pool2d(x, 3, 2, ceil_mode=True)
    yield "pool1", x
    for i in FIRES:
        x = F.relu(part(f"fire{i}.squeeze1x1", x))
        x = torch.cat([F.relu(part(f"fire{i}.expand{k}", x)) for k in ("1x1", "3x3")], 1)
        yield f"fire{i}", x
        if i in POOLED:
            x = F.max_pool2d(x, 3, 2, ceil_mode=True)
            yield f"pool{i}", x


# torchvision numbers modules, pools included: features.0 is conv1, features.3 is fire2 ...
TORCHVISION = {2: 3, 3: 4, 4: 6, 5: 7, 6: 9, 7: 10, 8: 11, 9: 12}


def aliases(name: str) -> list[str]:
    """Other names of a tensor: Keras' and torchvision's."""
    layer, role = name.rsplit(".", 1)
    keras = f"{layer.replace('.', '/')}/{'kernel' if role == 'weight' else role}"
    if layer == "conv1":
        return [keras, f"features.0.{role}"]
    fire, conv = layer.split(".")
    return [keras, f"features.{TORCHVISION[int(fire[4:])]}.{conv.replace('squeeze1x1', 'squeeze')}.{role}"]


def fit(
    tensors: Mapping[str, npt.NDArray[Any]], shapes: Mapping[str, tuple[int, ...]]
) -> dict[str, npt.NDArray[np.float32]]:
    """A file's tensors under our names; a torchvision state dict (RGB) with conv1's inputs turned to BGR."""
    fitted = fit_named(tensors, shapes, aliases)
    if any("features." in name for name in tensors):
        fitted["conv1.weight"] = np.ascontiguousarray(fitted["conv1.weight"][:, ::-1])
    return fitted


_ARCHITECTURE = Architecture(_parts(), forward)

# keras-squeezenet's file, conv1 taking BGR.
KNOWN = {
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

NETWORK = Network(
    name="squeezenet",
    title="SqueezeNet 1.1",
    layers=_ARCHITECTURE.layers,
    default_layer="pool1",
    default_descriptors=("fire5",),
    build=_ARCHITECTURE.build,
    tensor_shapes=_ARCHITECTURE.tensor_shapes,
    fit=fit,
    source_title="SqueezeNet 1.1 of keras-squeezenet (ImageNet)",
    licence="MIT",
    known=KNOWN,
    sources=(
        # Published without a hash: the fingerprints above prove the tensors.
        Download(
            "https://github.com/rcmalli/keras-squeezenet/releases/download/v1.0/"
            "squeezenet_weights_tf_dim_ordering_tf_kernels_notop.h5",
            "",
        ),
    ),
    hint="keras-squeezenet's file, or torchvision's squeezenet1_1-b8a52dc0.pth",
    preprocessing=Preprocessing(color="bgr", standardize=True),
    trained_with=Preprocessing(color="bgr", standardize=False, mean=(104.0, 117.0, 123.0)),
)
