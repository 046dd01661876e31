"""The AlexNet that torchvision has: one tower, without normalisation.

Krizhevsky, "One weird trick for parallelizing convolutional neural networks", 2014.  Layers as in `alexnet`.
"""

from __future__ import annotations

from dataclasses import replace

from elf_export.sources.weights.sources import Download

from . import alexnet
from .parts.architecture import Architecture, Conv

_ARCHITECTURE = Architecture(
    {
        "conv1": Conv(3, 64, 11, stride=4, padding=2),
        "conv2": Conv(64, 192, 5, padding=2),
        "conv3": Conv(192, 384, 3, padding=1),
        "conv4": Conv(384, 256, 3, padding=1),
        "conv5": Conv(256, 256, 3, padding=1),
    },
    alexnet.plain,
)

NETWORK = replace(
    alexnet.NETWORK,
    name="alexnet_torchvision",
    title="AlexNet, torchvision's",
    layers=_ARCHITECTURE.layers,
    build=_ARCHITECTURE.build,
    tensor_shapes=_ARCHITECTURE.tensor_shapes,
    source_title="torchvision's AlexNet (ImageNet)",
    licence="BSD-3-Clause",
    known={},
    trained_with=None,
    sources=(
        # The file's name carries the beginning of its SHA-256, as all of torchvision's do.
        Download("https://download.pytorch.org/models/alexnet-owt-7be5be79.pth", "7be5be79"),
    ),
    hint="",
)
