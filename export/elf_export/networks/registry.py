"""What the exporter must know about a named network."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from elf_export.errors import ExportError, LayerError
from elf_export.preprocessing import Preprocessing
from elf_export.weights.sources import Download, Wheel
from elf_runtime import DetectionParams

if TYPE_CHECKING:
    import torch

Tensors = Mapping[str, npt.NDArray[np.float32]]

# One entry a module of this package, so that listing the names imports none of them.
_MODULES = ("vgg",)


@dataclass(frozen=True)
class Network:
    """A named network.

    Attributes
    ----------
    name : str
        As in ``--net``.
    layers : sequence of str
        All layer names in forward order.
    default_layer, default_descriptors
        The paper's.
    build : function
        ``build(tensors, layers)`` makes a torch module in eval mode whose ``forward(x)`` returns the maps of
        `layers`, in that order; x is (N, C, H, W) float, already preprocessed.
    tensor_shapes : function
        ``tensor_shapes(layers)``: the tensors that these layers need, name -> shape.
    fit : function
        ``fit(tensors, shapes)`` makes the tensors of any file fit `tensor_shapes`: names, layout, colour order.
    known : mapping
        Layer -> fingerprint of its tensors in the weights that `source_title` names.
    sources : sequence of Download or Wheel
        Where these weights can be had, in order of preference.
    """

    name: str
    title: str
    layers: Sequence[str]
    default_layer: str
    default_descriptors: Sequence[str]
    build: Callable[[Tensors, Sequence[str]], torch.nn.Module]
    tensor_shapes: Callable[[Sequence[str]], dict[str, tuple[int, ...]]]
    fit: Callable[[Mapping[str, npt.NDArray[Any]], Mapping[str, tuple[int, ...]]], dict[str, npt.NDArray[np.float32]]]
    source_title: str
    licence: str
    known: Mapping[str, str] = field(default_factory=dict)
    sources: Sequence[Download | Wheel] = ()
    preprocessing: Preprocessing = field(default_factory=Preprocessing)
    detection: DetectionParams = field(default_factory=DetectionParams)

    def check_layers(self, layers: Sequence[str]) -> None:
        """Raise LayerError on an unknown layer, naming the known ones."""
        for layer in layers:
            if layer not in self.layers:
                raise LayerError(f"{self.name} has no layer {layer!r}; it has {', '.join(self.layers)}")


def network_names() -> list[str]:
    return list(_MODULES)


def get_network(name: str) -> Network:
    """The network called `name`.

    Raises
    ------
    ExportError
        If there is none.
    """
    if name not in _MODULES:
        raise ExportError(f"unknown network {name!r}; known are {', '.join(_MODULES)}")
    network = importlib.import_module(f".{name}", __package__).NETWORK
    assert isinstance(network, Network)
    return network
