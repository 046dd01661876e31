"""ResNet-18.  He, Zhang, Ren, Sun, "Deep residual learning for image recognition", 2015.

Names are torchvision's.  Layers: ``conv1``, ``bn1``, ``relu``, ``maxpool``, and the blocks ``layerL.B``
behind their sum and ReLU.
"""

from __future__ import annotations

import torch
from torch.nn import functional as F

from elf_export.preprocessing import Preprocessing
from elf_export.sources.weights.fit import fit_named
from elf_export.sources.weights.sources import Download

from .parts.architecture import Architecture, Conv, Maps, Norm, Part
from .parts.network import Network

# stage -> (inputs, channels, stride of the first block); two blocks a stage
STAGES = {1: (64, 64, 1), 2: (64, 128, 2), 3: (128, 256, 2), 4: (256, 512, 2)}


def _parts() -> dict[str, Conv | Norm]:
    parts: dict[str, Conv | Norm] = {"conv1": Conv(3, 64, 7, 2, 3, bias=False), "bn1": Norm(64)}
    for stage, (inputs, channels, stride) in STAGES.items():
        for block, (before, step) in enumerate([(inputs, stride), (channels, 1)]):
            name = f"layer{stage}.{block}"
            parts[f"{name}.conv1"] = Conv(before, channels, 3, step, 1, bias=False)
            parts[f"{name}.bn1"] = Norm(channels)
            parts[f"{name}.conv2"] = Conv(channels, channels, 3, 1, 1, bias=False)
            parts[f"{name}.bn2"] = Norm(channels)
            if before != channels:
                parts[f"{name}.downsample.0"] = Conv(before, channels, 1, step, bias=False)
                parts[f"{name}.downsample.1"] = Norm(channels)
    return parts


PARTS = _parts()


def forward(part: Part, x: torch.Tensor) -> Maps:
    x = part("conv1", x)
    yield "conv1", x
    x = part("bn1", x)
    yield "bn1", x
    x = F.relu(x)
    yield "relu", x
    x = F.max_pool2d(x, 3, 2, 1)
    yield "maxpool", x
    for stage in STAGES:
        for name in (f"layer{stage}.0", f"layer{stage}.1"):
            y = F.relu(part(f"{name}.bn1", part(f"{name}.conv1", x)))
            y = part(f"{name}.bn2", part(f"{name}.conv2", y))
            if f"{name}.downsample.0" in PARTS:
                x = part(f"{name}.downsample.1", part(f"{name}.downsample.0", x))
            x = F.relu(y + x)
            yield name, x


_ARCHITECTURE = Architecture(PARTS, forward)

NETWORK = Network(
    name="resnet18",
    title="ResNet-18",
    layers=_ARCHITECTURE.layers,
    default_layer="layer1.1",
    default_descriptors=("layer3.1",),
    build=_ARCHITECTURE.build,
    tensor_shapes=_ARCHITECTURE.tensor_shapes,
    fit=fit_named,
    source_title="torchvision's ResNet-18 (ImageNet)",
    licence="BSD-3-Clause",
    sources=(
        Download(
            "https://download.pytorch.org/models/resnet18-f37072fd.pth",
            "f37072fd47e89c5e827621c5baffa7500819f7896bbacec160b1a16c560e07ec",
        ),
    ),
    preprocessing=Preprocessing(color="rgb", standardize=True),
    trained_with=Preprocessing("rgb", False, 1 / 255, (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)),
)
