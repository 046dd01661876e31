"""MobileNetV2.  Sandler et al., "MobileNetV2: inverted residuals and linear bottlenecks", 2018.

Names are torchvision's.  Layers: ``features.0`` behind its ReLU6, the bottlenecks ``features.N`` (linear,
the sum included where there is one), and ``features.18``.
"""

from __future__ import annotations

import torch
from torch.nn import functional as F

from elf_export.preprocessing import Preprocessing
from elf_export.sources.weights.fit import fit_named
from elf_export.sources.weights.sources import Download

from .parts.architecture import Architecture, Conv, Maps, Norm, Part
from .parts.network import Network

# (expansion, channels, blocks, stride of the first): table 2 of the paper
TABLE = (
    (1, 16, 1, 1), (6, 24, 2, 2), (6, 32, 3, 2), (6, 64, 4, 2), (6, 96, 3, 1), (6, 160, 3, 2), (6, 320, 1, 1),
)  # fmt: skip


def _blocks() -> dict[str, tuple[int, int, int, int]]:
    """Name -> (inputs, hidden channels, outputs, stride)."""
    blocks: dict[str, tuple[int, int, int, int]] = {}
    inputs = 32
    for expansion, outputs, count, stride in TABLE:
        for i in range(count):
            blocks[f"features.{len(blocks) + 1}"] = (
                inputs,
                inputs * expansion,
                outputs,
                stride if i == 0 else 1,
            )
            inputs = outputs
    return blocks


BLOCKS = _blocks()


def _parts() -> dict[str, Conv | Norm]:
    parts: dict[str, Conv | Norm] = {
        "features.0.0": Conv(3, 32, 3, 2, 1, bias=False),
        "features.0.1": Norm(32),
    }
    for name, (inputs, hidden, outputs, stride) in BLOCKS.items():
        expands = hidden != inputs
        if expands:
            parts[f"{name}.conv.0.0"] = Conv(inputs, hidden, 1, bias=False)
            parts[f"{name}.conv.0.1"] = Norm(hidden)
        parts[f"{name}.conv.{int(expands)}.0"] = Conv(hidden, hidden, 3, stride, 1, groups=hidden, bias=False)
        parts[f"{name}.conv.{int(expands)}.1"] = Norm(hidden)
        parts[f"{name}.conv.{1 + expands}"] = Conv(hidden, outputs, 1, bias=False)
        parts[f"{name}.conv.{2 + expands}"] = Norm(outputs)
    return parts | {"features.18.0": Conv(320, 1280, 1, bias=False), "features.18.1": Norm(1280)}


def forward(part: Part, x: torch.Tensor) -> Maps:
    def activated(name: str, x: torch.Tensor) -> torch.Tensor:
        return F.relu6(part(f"{name}.1", part(f"{name}.0", x)))

    x = activated("features.0", x)
    yield "features.0", x
    for name, (inputs, hidden, outputs, stride) in BLOCKS.items():
        expands = int(hidden != inputs)
        y = activated(f"{name}.conv.0", x) if expands else x
        y = activated(f"{name}.conv.{expands}", y)
        y = part(f"{name}.conv.{2 + expands}", part(f"{name}.conv.{1 + expands}", y))
        x = x + y if stride == 1 and inputs == outputs else y
        yield name, x
    x = activated("features.18", x)
    yield "features.18", x


_ARCHITECTURE = Architecture(_parts(), forward)

NETWORK = Network(
    name="mobilenet_v2",
    title="MobileNetV2",
    layers=_ARCHITECTURE.layers,
    default_layer="features.3",
    default_descriptors=("features.6",),
    build=_ARCHITECTURE.build,
    tensor_shapes=_ARCHITECTURE.tensor_shapes,
    fit=fit_named,
    source_title="torchvision's MobileNetV2 (ImageNet)",
    licence="BSD-3-Clause",
    sources=(Download("https://download.pytorch.org/models/mobilenet_v2-b0353104.pth", "b0353104"),),
    preprocessing=Preprocessing(color="rgb", standardize=True),
    trained_with=Preprocessing("rgb", False, 1 / 255, (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)),
)
