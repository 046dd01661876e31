"""MobileNetV3-Small.  Howard et al., "Searching for MobileNetV3", 2019.

Names are torchvision's.  Layers: ``features.0`` behind its hard swish, the bottlenecks ``features.N``
(linear, the sum included where there is one), and ``features.12``.
"""

from __future__ import annotations

import torch
from torch.nn import functional as F

from elf_export.preprocessing import Preprocessing
from elf_export.sources.weights.fit import fit_named
from elf_export.sources.weights.sources import Download

from .parts.architecture import Architecture, Conv, Maps, Norm, Part
from .parts.network import Network

EPS = 1e-3

# inputs, kernel, hidden channels, outputs, squeezed channels (0: none), hard swish, stride: table 2
BLOCKS = {
    f"features.{i}": row
    for i, row in enumerate(
        (
            (16, 3, 16, 16, 8, False, 2),
            (16, 3, 72, 24, 0, False, 2),
            (24, 3, 88, 24, 0, False, 1),
            (24, 5, 96, 40, 24, True, 2),
            (40, 5, 240, 40, 64, True, 1),
            (40, 5, 240, 40, 64, True, 1),
            (40, 5, 120, 48, 32, True, 1),
            (48, 5, 144, 48, 40, True, 1),
            (48, 5, 288, 96, 72, True, 2),
            (96, 5, 576, 96, 144, True, 1),
            (96, 5, 576, 96, 144, True, 1),
        ),
        1,
    )
}


def _parts() -> dict[str, Conv | Norm]:
    parts: dict[str, Conv | Norm] = {}

    def add(name: str, conv: Conv) -> None:
        parts[f"{name}.0"], parts[f"{name}.1"] = conv, Norm(conv.outputs, EPS)

    add("features.0", Conv(3, 16, 3, 2, 1, bias=False))
    for name, (inputs, kernel, hidden, outputs, squeezed, _, stride) in BLOCKS.items():
        step = 0
        if hidden != inputs:
            add(f"{name}.block.0", Conv(inputs, hidden, 1, bias=False))
            step = 1
        depthwise = Conv(hidden, hidden, kernel, stride, kernel // 2, groups=hidden, bias=False)
        add(f"{name}.block.{step}", depthwise)
        if squeezed:
            step += 1
            parts[f"{name}.block.{step}.fc1"] = Conv(hidden, squeezed, 1)
            parts[f"{name}.block.{step}.fc2"] = Conv(squeezed, hidden, 1)
        add(f"{name}.block.{step + 1}", Conv(hidden, outputs, 1, bias=False))
    add("features.12", Conv(96, 576, 1, bias=False))
    return parts


def forward(part: Part, x: torch.Tensor) -> Maps:
    def normalized(name: str, x: torch.Tensor) -> torch.Tensor:
        return part(f"{name}.1", part(f"{name}.0", x))

    x = F.hardswish(normalized("features.0", x))
    yield "features.0", x
    for name, (inputs, _, hidden, outputs, squeezed, swish, stride) in BLOCKS.items():
        act = F.hardswish if swish else F.relu
        y, step = x, 0
        if hidden != inputs:
            y = act(normalized(f"{name}.block.0", y))
            step = 1
        y = act(normalized(f"{name}.block.{step}", y))
        if squeezed:
            step += 1
            gate = F.relu(part(f"{name}.block.{step}.fc1", F.adaptive_avg_pool2d(y, 1)))
            y = y * F.hardsigmoid(part(f"{name}.block.{step}.fc2", gate))
        y = normalized(f"{name}.block.{step + 1}", y)
        x = x + y if stride == 1 and inputs == outputs else y
        yield name, x
    x = F.hardswish(normalized("features.12", x))
    yield "features.12", x


_ARCHITECTURE = Architecture(_parts(), forward)

NETWORK = Network(
    name="mobilenet_v3_small",
    title="MobileNetV3-Small",
    layers=_ARCHITECTURE.layers,
    default_layer="features.1",
    default_descriptors=("features.3",),
    build=_ARCHITECTURE.build,
    tensor_shapes=_ARCHITECTURE.tensor_shapes,
    fit=fit_named,
    source_title="torchvision's MobileNetV3-Small (ImageNet)",
    licence="BSD-3-Clause",
    sources=(
        Download(
            "https://download.pytorch.org/models/mobilenet_v3_small-047dcff4.pth",
            "047dcff4addef86ea5bc2eff13c9614dc11f47ab1160d0a71a25e7db994f4e1f",
        ),
    ),
    preprocessing=Preprocessing(color="rgb", standardize=True),
    trained_with=Preprocessing("rgb", False, 1 / 255, (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)),
)
