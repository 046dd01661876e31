"""What the exporter must know about a named network."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from elf_export.errors import LayerError
from elf_export.preprocessing import Preprocessing
from elf_export.sources.weights.sources import Download, Wheel
from elf_runtime import DetectionParams, preset
from elf_runtime.errors import suggestion

if TYPE_CHECKING:
    import torch

Tensors = Mapping[str, npt.NDArray[np.float32]]


@dataclass(frozen=True)
class Network:
    """A named network.

    Attributes
    ----------
    name : str
        As in ``--net``, and as its file is called.
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
        ``fit(tensors, shapes)`` makes any file's tensors fit `tensor_shapes`: names, layout, colour order.
    known : mapping
        Layer -> fingerprint of its tensors in the weights that `source_title` names.
    sources : sequence of Download or Wheel
        Where these weights can be had, in order of preference.
    hint : str
        What to give with --weights where `sources` has nothing.
    detection : DetectionParams
        The settings that exported models start from: the paper's blurs for this network.
    preprocessing : Preprocessing
        What ELF feeds the network: the paper standardises each image, whatever the network was trained with.
    trained_with : Preprocessing, optional
        What the network was trained with; ``--preprocess own`` takes it.
    gradient : bool
        The saliency is F's input gradient; False where F itself is the saliency map (Sobel, Laplacian).
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
    hint: str = ""
    preprocessing: Preprocessing = field(default_factory=Preprocessing)
    trained_with: Preprocessing | None = None
    gradient: bool = True

    @property
    def detection(self) -> DetectionParams:
        # Not the paper's 8 bits, and nothing on a blank wall.
        return preset("paper", self.name).updated(quantize=False, min_contrast=DetectionParams.min_contrast)

    def check_layers(self, layers: Sequence[str]) -> None:
        """Raise LayerError on an unknown layer, naming the known ones."""
        for layer in layers:
            if layer not in self.layers:
                near = suggestion(layer, self.layers)
                raise LayerError(f"{self.name} has no layer {layer!r}; it has {', '.join(self.layers)}{near}")
