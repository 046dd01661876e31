"""EfficientNet-Lite0: EfficientNet-B0 (Tan, Le, 2019) with ReLU6 and without squeeze and excitation.

Names and geometry (symmetric padding) are those of timm's ``efficientnet_lite0``.  Layers: ``stem`` behind
its ReLU6, the bottlenecks ``blocks.S.B`` (linear, the sum included where there is one), and ``head``.
"""

from __future__ import annotations

import torch
from torch.nn import functional as F

from elf_export.preprocessing import Preprocessing
from elf_export.sources.weights.fit import fit_named
from elf_export.sources.weights.sources import Download

from .parts.architecture import Architecture, Conv, Maps, Norm, Part
from .parts.network import Network

# (expansion, kernel, channels, blocks, stride of the first): table 1 of the paper
TABLE = (
    (1, 3, 16, 1, 1), (6, 3, 24, 2, 2), (6, 5, 40, 2, 2), (6, 3, 80, 3, 2), (6, 5, 112, 3, 1),
    (6, 5, 192, 4, 2), (6, 3, 320, 1, 1),
)  # fmt: skip


def _blocks() -> dict[str, tuple[int, int, int, int, int]]:
    """Name -> (inputs, hidden channels, kernel, outputs, stride)."""
    blocks, inputs = {}, 32
    for stage, (expansion, kernel, outputs, count, stride) in enumerate(TABLE):
        for i in range(count):
            hidden, step = inputs * expansion, stride if i == 0 else 1
            blocks[f"blocks.{stage}.{i}"] = inputs, hidden, kernel, outputs, step
            inputs = outputs
    return blocks


BLOCKS = _blocks()


def _parts() -> dict[str, Conv | Norm]:
    parts: dict[str, Conv | Norm] = {"conv_stem": Conv(3, 32, 3, 2, 1, bias=False), "bn1": Norm(32)}
    for name, (inputs, hidden, kernel, outputs, stride) in BLOCKS.items():
        depthwise = Conv(hidden, hidden, kernel, stride, kernel // 2, groups=hidden, bias=False)
        if hidden == inputs:
            parts |= {f"{name}.conv_dw": depthwise, f"{name}.bn1": Norm(hidden)}
            parts |= {f"{name}.conv_pw": Conv(hidden, outputs, 1, bias=False), f"{name}.bn2": Norm(outputs)}
        else:
            parts |= {f"{name}.conv_pw": Conv(inputs, hidden, 1, bias=False), f"{name}.bn1": Norm(hidden)}
            parts |= {f"{name}.conv_dw": depthwise, f"{name}.bn2": Norm(hidden)}
            parts |= {f"{name}.conv_pwl": Conv(hidden, outputs, 1, bias=False), f"{name}.bn3": Norm(outputs)}
    return parts | {"conv_head": Conv(320, 1280, 1, bias=False), "bn2": Norm(1280)}


def forward(part: Part, x: torch.Tensor) -> Maps:
    x = F.relu6(part("bn1", part("conv_stem", x)))
    yield "stem", x
    for name, (inputs, hidden, _, outputs, stride) in BLOCKS.items():
        first, second = ("conv_dw", "conv_pw") if hidden == inputs else ("conv_pw", "conv_dw")
        y = F.relu6(part(f"{name}.bn1", part(f"{name}.{first}", x)))
        y = part(f"{name}.bn2", part(f"{name}.{second}", y))
        if hidden != inputs:
            y = part(f"{name}.bn3", part(f"{name}.conv_pwl", F.relu6(y)))
        x = x + y if stride == 1 and inputs == outputs else y
        yield name, x
    x = F.relu6(part("bn2", part("conv_head", x)))
    yield "head", x


_ARCHITECTURE = Architecture(_parts(), forward)

NETWORK = Network(
    name="efficientnet_lite0",
    title="EfficientNet-Lite0",
    layers=_ARCHITECTURE.layers,
    default_layer="blocks.1.1",
    default_descriptors=("blocks.2.1",),
    build=_ARCHITECTURE.build,
    tensor_shapes=_ARCHITECTURE.tensor_shapes,
    fit=fit_named,
    source_title="timm's EfficientNet-Lite0 (ImageNet)",
    licence="Apache-2.0",
    sources=(
        Download(
            "https://github.com/rwightman/pytorch-image-models/releases/download/v0.1-weights/"
            "efficientnet_lite0_ra-37913777.pth",
            "37913777",
        ),
    ),
    preprocessing=Preprocessing(color="rgb", standardize=True),
    trained_with=Preprocessing("rgb", False, 1 / 255, (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)),
)
