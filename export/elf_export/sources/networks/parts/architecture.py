"""A named network as a table of its parts and a short forward function.

The table says which trained tensors there are; the function says how the image runs through them and which
values on the way have a name.  Both together are the network's layers, its tensors' shapes and its module.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import torch
from torch import nn

from .network import Tensors

PROBE = 160  # pixels: no pool of a network here runs empty on it

Part = Callable[[str, torch.Tensor], torch.Tensor]
"""part(name, x): x through the part of that name."""

Maps = Iterator[tuple[str, torch.Tensor]]
"""Layer names and their maps, in forward order."""


@dataclass(frozen=True)
class Conv:
    """A convolution; `padding` is zeros on each side."""

    inputs: int
    outputs: int
    kernel: int
    stride: int = 1
    padding: int = 0
    groups: int = 1
    bias: bool = True

    def shapes(self) -> dict[str, tuple[int, ...]]:
        weight = {"weight": (self.outputs, self.inputs // self.groups, self.kernel, self.kernel)}
        return weight | ({"bias": (self.outputs,)} if self.bias else {})

    def module(self, device: str) -> nn.Module:
        return nn.Conv2d(
            self.inputs, self.outputs, self.kernel, self.stride, self.padding,
            groups=self.groups, bias=self.bias, device=device,
        )  # fmt: skip


@dataclass(frozen=True)
class Norm:
    """A batch normalisation with the statistics of the training."""

    channels: int
    eps: float = 1e-5

    def shapes(self) -> dict[str, tuple[int, ...]]:
        return dict.fromkeys(("weight", "bias", "running_mean", "running_var"), (self.channels,))

    def module(self, device: str) -> nn.Module:
        return nn.BatchNorm2d(self.channels, self.eps, device=device)


@dataclass(frozen=True)
class Architecture:
    """What `Network` needs of a network: `layers`, `tensor_shapes` and `build`.

    Attributes
    ----------
    parts : mapping
        All trained parts by name; a dot nests, as in torch's state dicts.
    forward : function
        ``forward(part, x)`` yields (layer, map); it is stopped after the deepest layer that is asked for.
    channels : int
        Of the image.
    """

    parts: Mapping[str, Conv | Norm]
    forward: Callable[[Part, torch.Tensor], Maps]
    channels: int = 3

    @cached_property
    def layers(self) -> tuple[str, ...]:
        """All layer names in forward order."""
        return tuple(self._traced(None)[0])

    def tensor_shapes(self, layers: Sequence[str]) -> dict[str, tuple[int, ...]]:
        """Shapes of the tensors that `layers` need, in the order of the table."""
        used = self._traced(tuple(layers))[1]
        return {
            f"{name}.{role}": shape
            for name, part in self.parts.items()
            if name in used
            for role, shape in part.shapes().items()
        }

    def build(self, tensors: Tensors, layers: Sequence[str]) -> nn.Module:
        """A torch module in eval mode that returns the maps of `layers`."""
        shapes = self.tensor_shapes(layers)
        names = [name for name in self.parts if any(f"{name}.{role}" in shapes for role in self.parts[name].shapes())]
        module = Tapped(self.forward, {name: self.parts[name].module("cpu") for name in names}, layers)
        module.load_state_dict({name: torch.tensor(tensors[name]) for name in shapes}, strict=False)
        return module.eval().requires_grad_(False)

    def _traced(self, layers: tuple[str, ...] | None) -> tuple[list[str], set[str]]:
        return _trace(self.forward, tuple(self.parts.items()), self.channels, layers)


@lru_cache(maxsize=256)
def _trace(
    forward: Callable[[Part, torch.Tensor], Maps],
    parts: tuple[tuple[str, Conv | Norm], ...],
    channels: int,
    layers: tuple[str, ...] | None,
) -> tuple[list[str], set[str]]:
    """Layers that are passed and parts that are used until `layers` (None: all) are there.

    The network runs on torch's meta device: shapes without numbers.
    """
    table, used, passed = dict(parts), set[str](), list[str]()

    def part(name: str, x: torch.Tensor) -> torch.Tensor:
        used.add(name)
        y: torch.Tensor = table[name].module("meta").eval()(x)
        return y

    for name, _ in forward(part, torch.empty(1, channels, PROBE, PROBE, device="meta")):
        passed.append(name)
        if layers is not None and set(layers) <= set(passed):
            break
    return passed, used


class Tapped(nn.Module):
    """A forward function over its parts that stops at, and returns, the wanted layers."""

    def __init__(
        self,
        forward: Callable[[Part, torch.Tensor], Maps],
        parts: Mapping[str, nn.Module],
        layers: Sequence[str],
    ) -> None:
        super().__init__()
        self._run, self._layers = forward, tuple(layers)
        for name, part in parts.items():
            self._nest(name, part)

    def _nest(self, name: str, part: nn.Module) -> None:
        *folders, last = name.split(".")
        at: nn.Module = self
        for folder in folders:
            if folder not in dict(at.named_children()):
                at.add_module(folder, nn.Module())
            at = at.get_submodule(folder)
        at.add_module(last, part)

    def _part(self, name: str, x: torch.Tensor) -> torch.Tensor:
        y: torch.Tensor = self.get_submodule(name)(x)
        return y

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, ...]:
        maps: dict[str, torch.Tensor] = {}
        for name, value in self._run(self._part, x):
            maps[name] = value
            if all(layer in maps for layer in self._layers):
                break
        return tuple(maps[layer] for layer in self._layers)
