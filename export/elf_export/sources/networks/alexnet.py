"""AlexNet.  Krizhevsky, Sutskever, Hinton, "ImageNet classification with deep convolutional networks", 2012.

Three of them: ``alexnet`` is Caffe's (96 filters, convolutions in two groups) with its local response
normalisation before the pools; ``alexnet_plain`` is the same without it; ``alexnet_torchvision`` is the
one-tower network of "One weird trick" (2014) that torchvision carries.

Layers: ``convI`` before its ReLU, ``reluI`` behind it, ``normI`` behind the normalisation, ``poolI``.
Windows that reach over the image's end are left out, where Caffe keeps them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch.nn import functional as F

from elf_export.preprocessing import Preprocessing
from elf_export.sources.weights.fit import fit_chain
from elf_export.sources.weights.sources import Download

from .architecture import Architecture, Conv, Maps, Part
from .known import CAFFE_ALEXNET_8BIT
from .onnx_ops import local_response_norm
from .registry import Network

POOLED = (1, 2, 5)
NORMALIZED = (1, 2)

CAFFE = {
    "conv1": Conv(3, 96, 11, stride=4),
    "conv2": Conv(96, 256, 5, padding=2, groups=2),
    "conv3": Conv(256, 384, 3, padding=1),
    "conv4": Conv(384, 384, 3, padding=1, groups=2),
    "conv5": Conv(384, 256, 3, padding=1, groups=2),
}
TORCHVISION = {
    "conv1": Conv(3, 64, 11, stride=4, padding=2),
    "conv2": Conv(64, 192, 5, padding=2),
    "conv3": Conv(192, 384, 3, padding=1),
    "conv4": Conv(384, 256, 3, padding=1),
    "conv5": Conv(256, 256, 3, padding=1),
}


def plain(part: Part, x: torch.Tensor) -> Maps:
    """conv -> ReLU -> pool"""
    return _forward(part, x, ())


def normalized(part: Part, x: torch.Tensor) -> Maps:
    """conv -> ReLU -> local response normalisation -> pool, as Caffe's deploy file has it."""
    return _forward(part, x, NORMALIZED)


def _forward(part: Part, x: torch.Tensor, norms: tuple[int, ...]) -> Maps:
    for i in range(1, 6):
        x = part(f"conv{i}", x)
        yield f"conv{i}", x
        x = F.relu(x)
        yield f"relu{i}", x
        if i in norms:
            x = local_response_norm(x, size=5, alpha=1e-4, beta=0.75, k=1.0)
            yield f"norm{i}", x
        if i in POOLED:
            x = F.max_pool2d(x, 3, 2)
            yield f"pool{i}", x


def fit_bgr(
    tensors: Mapping[str, npt.NDArray[Any]], shapes: Mapping[str, tuple[int, ...]]
) -> dict[str, npt.NDArray[np.float32]]:
    """A file's tensors under our names; a torchvision state dict (RGB) with conv1's inputs turned to BGR."""
    fitted = fit_chain(tensors, shapes)
    if any(name.startswith("features.") for name in tensors):
        fitted["conv1.weight"] = np.ascontiguousarray(fitted["conv1.weight"][:, ::-1])
    return fitted


_CAFFE = Architecture(CAFFE, normalized)
_PLAIN = Architecture(CAFFE, plain)
_TORCHVISION = Architecture(TORCHVISION, plain)

NETWORK = Network(
    name="alexnet",
    title="AlexNet, Caffe's, with local response normalisation",
    layers=_CAFFE.layers,
    default_layer="pool1",
    default_descriptors=("pool2",),
    build=_CAFFE.build,
    tensor_shapes=_CAFFE.tensor_shapes,
    fit=fit_bgr,
    source_title="AlexNet of the Caffe model zoo (ImageNet), 8-bit kernels",
    licence="research use",
    known=CAFFE_ALEXNET_8BIT,
    hint="Caffe's bvlc_alexnet, its convolutions conv1 to conv5 saved as .npz or .onnx",
    preprocessing=Preprocessing(color="bgr", standardize=True),
    trained_with=Preprocessing(color="bgr", standardize=False, mean=(104.0, 117.0, 123.0)),
)

PLAIN = replace(
    NETWORK,
    name="alexnet_plain",
    title="AlexNet, Caffe's, without normalisation",
    layers=_PLAIN.layers,
    build=_PLAIN.build,
    tensor_shapes=_PLAIN.tensor_shapes,
)

ONE_TOWER = replace(
    PLAIN,
    name="alexnet_torchvision",
    title="AlexNet, torchvision's",
    layers=_TORCHVISION.layers,
    build=_TORCHVISION.build,
    tensor_shapes=_TORCHVISION.tensor_shapes,
    source_title="torchvision's AlexNet (ImageNet)",
    licence="BSD-3-Clause",
    known={},
    trained_with=None,
    sources=(
        # The file's name carries the beginning of its SHA-256, as all of torchvision's do.
        Download("https://download.pytorch.org/models/alexnet-owt-7be5be79.pth", "7be5be79"),
    ),
    hint="",
)
