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

from .parts.architecture import Architecture, Conv, Maps, Part
from .parts.network import Network

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

# Magic Leap's superpoint_v1.pth, without the detector head.
KNOWN = {
    "conv1a": "9470549942f2d158692233f0f1de731e020b9b2400e1132362177a8f428829ac",
    "conv1b": "905e1136a304f8dbbaa1f1235a6bd6c4c22c41a7818cdc38ab51702e3b261d9c",
    "conv2a": "d43f88dfc59c5a7d1726dcb42886576d910feaec0b43d3a6c8eebc6b83a11d68",
    "conv2b": "5c1c81302717cbccb0e0257dfb335a083404bdf5a42801f10e7337b4f463c679",
    "conv3a": "cc5c01d90fe9726fdcfe26c657e14f67f7f008411ee6d8358359644de2e865d3",
    "conv3b": "f94bcacb700b56d400bfec1bd256e37a553712fc61cfacd5223b302559a3d72e",
    "conv4a": "a693f4356d53b905d327b97d073d4cf65d70c016a10ed0c78c07fad285affe0d",
    "conv4b": "ede60e40a25f3927bd94dd0aca75c1911282c7ec32ba393833092c906bbff132",
    "convDa": "ed27e212f766734255c394285fa2b044c88201bc18b2ebe0f73fd597c312dfb2",
    "convDb": "3c5bd05fd33a62fb847c34f88f89adcdb2f149cd506f7908f6a2429845022217",
}

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
    known=KNOWN,
    hint=(
        "superpoint_v1.pth of github.com/magicleap/SuperPointPretrainedNetwork, SHA-256 52b6708629640ca8...; "
        "its licence is NON-COMMERCIAL, which is why it is not fetched for you"
    ),
    preprocessing=Preprocessing(color="gray", standardize=True),
    trained_with=Preprocessing(color="gray", standardize=False, scale=1 / 255),
)
