"""ShuffleNetV2 1.0x.  Ma et al., "ShuffleNet V2: practical guidelines for efficient CNN architecture design", 2018.

Layers: ``conv1``, ``maxpool``, ``stageS.I``, the channels of unit I of a stage behind their shuffle, and ``conv5``.
"""

from __future__ import annotations

import torch
from torch.nn import functional as F

from elf_export.preprocessing import Preprocessing
from elf_export.sources.weights.fit import fit_named
from elf_export.sources.weights.sources import Download

from .parts.architecture import Architecture, Conv, Maps, Norm, Part
from .parts.network import Network

STAGES = {2: (24, 116, 4), 3: (116, 232, 8), 4: (232, 464, 4)}  # inputs, outputs, units


def _parts() -> dict[str, Conv | Norm]:
    parts: dict[str, Conv | Norm] = {}

    def add(folder: str, index: int, conv: Conv) -> None:
        parts[f"{folder}.{index}"], parts[f"{folder}.{index + 1}"] = conv, Norm(conv.outputs)

    def depthwise(channels: int, stride: int) -> Conv:
        return Conv(channels, channels, 3, stride, padding=1, groups=channels, bias=False)

    add("conv1", 0, Conv(3, 24, 3, stride=2, padding=1, bias=False))
    for stage, (inputs, outputs, units) in STAGES.items():
        half = outputs // 2
        for unit in range(units):
            name, stride = f"stage{stage}.{unit}", 1 if unit else 2
            if unit == 0:
                add(f"{name}.branch1", 0, depthwise(inputs, 2))
                add(f"{name}.branch1", 2, Conv(inputs, half, 1, bias=False))
            add(f"{name}.branch2", 0, Conv(half if unit else inputs, half, 1, bias=False))
            add(f"{name}.branch2", 3, depthwise(half, stride))
            add(f"{name}.branch2", 5, Conv(half, half, 1, bias=False))
    add("conv5", 0, Conv(464, 1024, 1, bias=False))
    return parts


def forward(part: Part, x: torch.Tensor) -> Maps:
    def conv(folder: str, index: int, x: torch.Tensor) -> torch.Tensor:
        return part(f"{folder}.{index + 1}", part(f"{folder}.{index}", x))

    x = F.relu(conv("conv1", 0, x))
    yield "conv1", x
    x = F.max_pool2d(x, 3, 2, 1)
    yield "maxpool", x
    for stage, (_, outputs, units) in STAGES.items():
        half = outputs // 2
        for unit in range(units):
            name = f"stage{stage}.{unit}"
            if unit:
                kept, x = x.chunk(2, 1)
            else:
                kept = F.relu(conv(f"{name}.branch1", 2, conv(f"{name}.branch1", 0, x)))
            x = conv(f"{name}.branch2", 3, F.relu(conv(f"{name}.branch2", 0, x)))
            x = torch.cat([kept, F.relu(conv(f"{name}.branch2", 5, x))], 1)
            x = x[:, [c // 2 + c % 2 * half for c in range(2 * half)]]  # the shuffle: a channel of each half in turn
            yield name, x
    yield "conv5", F.relu(conv("conv5", 0, x))


_ARCHITECTURE = Architecture(_parts(), forward)

NETWORK = Network(
    name="shufflenet_v2",
    title="ShuffleNetV2 1.0x",
    layers=_ARCHITECTURE.layers,
    default_layer="conv1",
    default_descriptors=("stage2.3",),
    build=_ARCHITECTURE.build,
    tensor_shapes=_ARCHITECTURE.tensor_shapes,
    fit=fit_named,
    source_title="torchvision's ShuffleNetV2 1.0x (ImageNet)",
    licence="BSD-3-Clause",
    sources=(Download("https://download.pytorch.org/models/shufflenetv2_x1-5666bf0f80.pth", "5666bf0f80"),),
    preprocessing=Preprocessing(color="rgb", standardize=True),
    trained_with=Preprocessing("rgb", False, 1 / 255, (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)),
)
