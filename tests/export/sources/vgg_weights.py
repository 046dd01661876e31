"""VGG's weights up to pool2, from the bundled model, and as Keras writes them."""

from __future__ import annotations

from pathlib import Path

import h5py

from elf_export.sources.networks import get_network
from elf_export.sources.weights.load import load_weights

VGG = get_network("vgg")
LAYERS = ["pool2"]
TENSORS = load_weights(VGG, LAYERS, offline=True).tensors
NAMES = [name.removesuffix(".weight") for name in TENSORS if name.endswith(".weight")]


def write_h5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        for name in NAMES:
            block, index = name[4], name[6]
            layer = f"block{block}_conv{index}"
            file[f"{layer}/{layer}_W_1:0"] = TENSORS[f"{name}.weight"].transpose(2, 3, 1, 0)
            file[f"{layer}/{layer}_b_1:0"] = TENSORS[f"{name}.bias"]
