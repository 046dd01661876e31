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

from .architecture import Architecture, Conv, Maps, Part
from .known import KERAS_SQUEEZENET
from .registry import Network

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
    known=KERAS_SQUEEZENET,
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
