"""AlexNet.  Krizhevsky, Sutskever, Hinton, "ImageNet classification with deep convolutional networks", 2012.

This is Caffe's: 96 filters, convolutions in two groups, and local response normalisation before the pools.
``alexnet_plain`` is the same without the normalisation, ``alexnet_torchvision`` another network.

Layers: ``convI`` before its ReLU, ``reluI`` behind it, ``normI`` behind the normalisation, ``poolI``.
Windows that reach over the image's end are left out, where Caffe keeps them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch.nn import functional as F

from elf_export.preprocessing import Preprocessing
from elf_export.sources.weights.fit import fit_chain

from .parts.architecture import Architecture, Conv, Maps, Part
from .parts.network import Network
from .parts.onnx_ops import local_response_norm

POOLED = (1, 2, 5)
NORMALIZED = (1, 2)

CAFFE = {
    "conv1": Conv(3, 96, 11, stride=4),
    "conv2": Conv(96, 256, 5, padding=2, groups=2),
    "conv3": Conv(256, 384, 3, padding=1),
    "conv4": Conv(384, 384, 3, padding=1, groups=2),
    "conv5": Conv(384, 256, 3, padding=1, groups=2),
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

# Caffe's AlexNet, its kernels rounded to multiples of 1/128.
KNOWN = {
    "conv1": "a7ddd9d54427221cd1bdde7a75b7ed4182bd9ce90a35852bf6732c30f6c5eeef",
    "conv2": "3c6450378ec417684cbd87fcc669bb108bad3cff69f1b67ab56531869d9fd6e0",
    "conv3": "a9720e2cc9fb6a0a0c12498153298434d5beff49f9676c5615d7bd5c755f205a",
    "conv4": "5f8ddf6d6553a9a7b00e3e0a35e0787a2cfc646e403a5fcf739104ef0a187aec",
    "conv5": "dca24722f65af3986efd1cc17d27163d5990af0f831906483d7be68c5131a21e",
}

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
    known=KNOWN,
    hint="Caffe's bvlc_alexnet, its convolutions conv1 to conv5 saved as .npz or .onnx",
    preprocessing=Preprocessing(color="bgr", standardize=True),
    trained_with=Preprocessing(color="bgr", standardize=False, mean=(104.0, 117.0, 123.0)),
)
