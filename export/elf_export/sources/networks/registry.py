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
from elf_export.sources.weights.sources import Download, Wheel
from elf_runtime import DetectionParams, preset

if TYPE_CHECKING:
    import torch

Tensors = Mapping[str, npt.NDArray[np.float32]]

# Name -> module of this package and the Network in it, so that listing the names imports none of them.
_NETWORKS = {
    "vgg": ("vgg", "NETWORK"),
    "alexnet": ("alexnet", "NETWORK"),
    "alexnet_plain": ("alexnet", "PLAIN"),
    "alexnet_torchvision": ("alexnet", "ONE_TOWER"),
    "xception": ("xception", "NETWORK"),
    "superpoint": ("superpoint", "NETWORK"),
    "lfnet": ("lfnet", "NETWORK"),
    "sobel": ("gradients", "SOBEL"),
    "laplacian": ("gradients", "LAPLACIAN"),
    "squeezenet": ("squeezenet", "NETWORK"),
    "resnet18": ("resnet", "NETWORK"),
    "mobilenet_v2": ("mobilenet_v2", "NETWORK"),
    "mobilenet_v3_small": ("mobilenet_v3", "NETWORK"),
    "efficientnet_lite0": ("efficientnet_lite", "NETWORK"),
}


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
                raise LayerError(f"{self.name} has no layer {layer!r}; it has {', '.join(self.layers)}")


def network_names() -> list[str]:
    return list(_NETWORKS)


def get_network(name: str) -> Network:
    """The network called `name`.

    Raises
    ------
    ExportError
        If there is none, or PyTorch, which named networks are built with, is not installed.
    """
    if name not in _NETWORKS:
        raise ExportError(f"unknown network {name!r}; known are {', '.join(_NETWORKS)}")
    module, attribute = _NETWORKS[name]
    try:
        network = getattr(importlib.import_module(f".{module}", __package__), attribute)
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise ExportError(f"--net {name} is built with PyTorch: pip install torch (the CPU build is enough)") from error
    assert isinstance(network, Network)
    return network
