"""SuperPoint's encoder and descriptor head.  DeTone, Malisiewicz, Rabinovich, "SuperPoint: self-supervised
interest point detection and description", 2018.

Layers: ``convNx`` before its ReLU, ``reluNx`` behind it, ``poolN``; of the descriptor head ``convDa``,
``reluDa``, ``convDb``, and ``desc``, convDb with unit vectors.  The paper's F is the linear ``conv1a``.
SuperPoint was trained on grey images divided by 255; its own descriptors want ``--preprocess own``.

Magic Leap's weights are for non-commercial research only: they are never fetched, shipped or bundled, and a
model that is made from them is bound by their licence.
"""

from __future__ import annotations

import torch
from torch.nn import functional as F

from elf_export.preprocessing import Preprocessing
from elf_export.sources.weights.fit import fit_chain

from .architecture import Architecture, Conv, Maps, Part
from .known import SUPERPOINT_V1
from .registry import Network

ENCODER = {
    "1a": Conv(1, 64, 3, padding=1),
    "1b": Conv(64, 64, 3, padding=1),
    "2a": Conv(64, 64, 3, padding=1),
    "2b": Conv(64, 64, 3, padding=1),
    "3a": Conv(64, 128, 3, padding=1),
    "3b": Conv(128, 128, 3, padding=1),
    "4a": Conv(128, 128, 3, padding=1),
    "4b": Conv(128, 128, 3, padding=1),
}
HEAD = {"Da": Conv(128, 256, 3, padding=1), "Db": Conv(256, 256, 1)}
POOLED = ("1b", "2b", "3b")


def forward(part: Part, x: torch.Tensor) -> Maps:
    for name in (*ENCODER, "Da"):
        x = part(f"conv{name}", x)
        yield f"conv{name}", x
        x = F.relu(x)
        yield f"relu{name}", x
        if name in POOLED:
            x = F.max_pool2d(x, 2)
            yield f"pool{name[0]}", x
    x = part("convDb", x)
    yield "convDb", x
    yield "desc", F.normalize(x, dim=1)


_ARCHITECTURE = Architecture({f"conv{name}": conv for name, conv in (ENCODER | HEAD).items()}, forward, channels=1)

NETWORK = Network(
    name="superpoint",
    title="SuperPoint's encoder and descriptor head (weights: NON-COMMERCIAL)",
    layers=_ARCHITECTURE.layers,
    default_layer="conv1a",
    default_descriptors=("vgg:pool3",),
    build=_ARCHITECTURE.build,
    tensor_shapes=_ARCHITECTURE.tensor_shapes,
    fit=fit_chain,
    source_title="SuperPoint v1, Magic Leap",
    licence="non-commercial research only (Magic Leap); do not redistribute",
    known=SUPERPOINT_V1,
    hint=(
        "superpoint_v1.pth of github.com/magicleap/SuperPointPretrainedNetwork, SHA-256 52b6708629640ca8...; "
        "its licence is NON-COMMERCIAL, which is why it is not fetched for you"
    ),
    preprocessing=Preprocessing(color="gray", standardize=True),
    trained_with=Preprocessing(color="gray", standardize=False, scale=1 / 255),
)
