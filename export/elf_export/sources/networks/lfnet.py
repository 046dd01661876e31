"""LF-Net's detector trunk.  Ono, Trulls, Fua, Yi, "LF-Net: learning local features from images", 2018,
section 3.1.

A first 5x5 convolution to 16 channels, then three residual blocks of pre-activation form: normalisation and
leaky ReLU, 5x5 convolution, normalisation and leaky ReLU, 5x5 convolution, plus the block's input.
Everything keeps the image's size.  Layers: ``init-conv``; of each block ``blockB-conv`` (its first
convolution), ``blockB-bn`` (the normalisation behind it), ``blockB`` (the sum).

The trained weights are TensorFlow checkpoints, which are read without TensorFlow; ``--weights NAME.index``, with
``NAME.data-00000-of-00001`` beside it, is all that is needed.  Of their variables those of the scope ``ConvOnlyResNet``
are the detector's, but for an optimiser's slots.

The released models' slope of the leaky ReLU is 0.2 and the normalisations' epsilon TensorFlow's 1e-3.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch.nn import functional as F

from elf_export.errors import WeightsError
from elf_export.preprocessing import Preprocessing
from elf_export.sources.weights.fit import shaped

from .parts.architecture import Architecture, Conv, Maps, Norm, Part
from .parts.network import Network

CHANNELS, KERNEL, SLOPE, EPS = 16, 5, 0.2, 1e-3
BLOCKS = (1, 2, 3)


def _parts() -> dict[str, Conv | Norm]:
    parts: dict[str, Conv | Norm] = {"init_conv": Conv(1, CHANNELS, KERNEL, padding=KERNEL // 2)}
    for block in BLOCKS:
        for norm, conv in (("pre-bn", "conv1"), ("mid-bn", "conv2")):
            parts[f"block-{block}.{norm}"] = Norm(CHANNELS, EPS)
            parts[f"block-{block}.{conv}"] = Conv(CHANNELS, CHANNELS, KERNEL, padding=KERNEL // 2)
    return parts


def forward(part: Part, x: torch.Tensor) -> Maps:
    x = part("init_conv", x)
    yield "init-conv", x
    for block in BLOCKS:
        y = F.leaky_relu(part(f"block-{block}.pre-bn", x), SLOPE)
        y = part(f"block-{block}.conv1", y)
        yield f"block{block}-conv", y
        y = part(f"block-{block}.mid-bn", y)
        yield f"block{block}-bn", y
        x = x + part(f"block-{block}.conv2", F.leaky_relu(y, SLOPE))
        yield f"block{block}", x


_ARCHITECTURE = Architecture(_parts(), forward, channels=1)

_SCOPE = "ConvOnlyResNet"
_NORM = {"weight": "gamma", "bias": "beta", "running_mean": "moving_mean", "running_var": "moving_variance"}
_CONV = {"weight": "weights|kernel", "bias": "biases|bias"}
# A scope of an optimiser's, whose variables have the names and shapes of the weights.
_SLOTS = r"(?i:[^/]*(adam|adagrad|adadelta|momentum|rmsprop|ftrl|optimi[sz]er|slot|movingaverage)[^/]*)"


def fit(
    tensors: Mapping[str, npt.NDArray[Any]], shapes: Mapping[str, tuple[int, ...]]
) -> dict[str, npt.NDArray[np.float32]]:
    """A checkpoint's variables (``[OUTER/]ConvOnlyResNet/block-1/conv1/weights``), or our own names, under our names.

    A convolution without a bias gets a zero one, a normalisation without scale or shift 1 or 0.

    Raises
    ------
    WeightsError
        Naming a tensor that is missing, of another shape, or for which there are several variables.
    """
    fitted = {}
    for name, shape in shapes.items():
        value = tensors.get(name)
        if value is None:
            part, role = name.rsplit(".", 1)
            value = _variable(tensors, part, role, shape)
        fitted[name] = shaped(name, value, shape)
    return fitted


def _variable(
    tensors: Mapping[str, npt.NDArray[Any]], part: str, role: str, shape: tuple[int, ...]
) -> npt.NDArray[Any] | None:
    """A part's variable, or what stands for one that the part does without; None where nothing of the part is there."""
    roles = _NORM if part.endswith("-bn") else _CONV
    found = _named(tensors, part, roles[role])
    if len(found) > 1:
        raise WeightsError(f"several variables could be {part}.{role}: {', '.join(sorted(found))}")
    if found:
        return tensors[found[0]]
    neutral = {"bias": np.zeros(shape, np.float32)}
    if roles is _NORM:
        neutral["weight"] = np.ones(shape, np.float32)
    return neutral.get(role) if _named(tensors, part, "|".join(roles.values())) else None


def _named(tensors: Mapping[str, npt.NDArray[Any]], part: str, own: str) -> list[str]:
    """The variables of a part that end in one of the names `own`: below one outer and one inner scope at most."""
    scope = f"((?!{_SLOTS}/)[^/]+/)?"
    name = re.compile(f"{scope}{_SCOPE}/{re.escape(part.replace('.', '/'))}/{scope}({own})")
    return [found for found in tensors if name.fullmatch(found)]


NETWORK = Network(
    name="lfnet",
    title="LF-Net's detector trunk (bring your own weights)",
    layers=_ARCHITECTURE.layers,
    default_layer="block2-bn",
    default_descriptors=("vgg:pool3",),
    build=_ARCHITECTURE.build,
    tensor_shapes=_ARCHITECTURE.tensor_shapes,
    fit=fit,
    source_title="LF-Net",
    licence="as the checkpoint's",
    hint=("the .index file of a checkpoint of github.com/vcg-uvic/lf-net-release, with its .data file beside it"),
    preprocessing=Preprocessing(color="gray", standardize=True),
)
