"""VGG16.  Simonyan, Zisserman, "Very deep convolutional networks for large-scale image recognition", 2014.

Layers: ``convB_I`` before its ReLU, ``reluB_I`` behind it, ``poolB``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..preprocessing import Preprocessing
from .registry import Network, Tensors

if TYPE_CHECKING:
    import torch

# block -> (convolutions, channels)
BLOCKS = ((2, 64), (2, 128), (3, 256), (3, 512), (3, 512))


def _layers() -> list[str]:
    names = []
    for block, (count, _) in enumerate(BLOCKS, 1):
        for i in range(1, count + 1):
            names += [f"conv{block}_{i}", f"relu{block}_{i}"]
        names.append(f"pool{block}")
    return names


LAYERS = tuple(_layers())


def tensor_shapes(layers: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Kernels (O, I, 3, 3) and biases (O,) of all convolutions up to the deepest of `layers`."""
    deepest = max(LAYERS.index(layer) for layer in layers)
    shapes: dict[str, tuple[int, ...]] = {}
    channels = 3
    for block, (count, width) in enumerate(BLOCKS, 1):
        for i in range(1, count + 1):
            name = f"conv{block}_{i}"
            if LAYERS.index(name) <= deepest:
                shapes[f"{name}.weight"] = (width, channels, 3, 3)
                shapes[f"{name}.bias"] = (width,)
            channels = width
    return shapes


def build(tensors: Tensors, layers: Sequence[str]) -> torch.nn.Module:
    """A torch module that returns the maps of `layers`."""
    import torch
    from torch import nn
    from torch.nn import functional as F

    class Vgg16(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            for name, shape in tensor_shapes(layers).items():
                if name.endswith(".weight"):
                    conv = nn.Conv2d(shape[1], shape[0], 3, padding=1)
                    key = name.removesuffix(".weight")
                    conv.weight.data = torch.from_numpy(tensors[name].copy())
                    conv.bias.data = torch.from_numpy(tensors[f"{key}.bias"].copy())  # type: ignore[union-attr]
                    self.add_module(key, conv)

        def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, ...]:
            maps: dict[str, torch.Tensor] = {}
            for name in LAYERS:
                if name.startswith("conv"):
                    x = self.get_submodule(name)(x)
                elif name.startswith("relu"):
                    x = F.relu(x)
                else:
                    x = F.max_pool2d(x, 2)
                maps[name] = x
                if all(layer in maps for layer in layers):
                    break
            return tuple(maps[layer] for layer in layers)

    return Vgg16().eval().requires_grad_(False)


NETWORK = Network(
    name="vgg",
    title="VGG16 (Oxford, ImageNet)",
    layers=LAYERS,
    default_layer="pool2",
    default_descriptors=("pool4",),
    build=build,
    tensor_shapes=tensor_shapes,
    preprocessing=Preprocessing(color="bgr", standardize=True),
)
