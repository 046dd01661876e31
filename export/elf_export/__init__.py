"""Builds ELF models: a CNN's forward pass and its explicit backward pass in one ONNX graph.

>>> from elf_export import export_network, build_saliency
>>> export_network("vgg", "pool2", ["pool4"], "elf-vgg-pool2.onnx")      # doctest: +SKIP
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import elf_runtime  # noqa: F401  (first: it prepares ONNX Runtime)

from .errors import ExportError, LayerError, UnsupportedGraphError, UnsupportedNode, VerificationError, WeightsError

if TYPE_CHECKING:
    from .compression.ranks import Compression
    from .descriptors.projection import Reduction
    from .graph.passes import convert_opset, single_precision
    from .library import export_network, export_onnx
    from .pipeline import ExportResult
    from .preprocessing import Preprocessing
    from .saliency import build_gradient, build_saliency
    from .sources.foreign.load import load_model

__all__ = [
    "Compression",
    "ExportError",
    "ExportResult",
    "LayerError",
    "Preprocessing",
    "Reduction",
    "UnsupportedGraphError",
    "UnsupportedNode",
    "VerificationError",
    "WeightsError",
    "build_gradient",
    "build_saliency",
    "convert_opset",
    "export_network",
    "export_onnx",
    "load_model",
    "single_precision",
]

_HOMES = {
    "Compression": "compression.ranks",
    "ExportResult": "pipeline",
    "Preprocessing": "preprocessing",
    "Reduction": "descriptors.projection",
    "build_gradient": "saliency",
    "build_saliency": "saliency",
    "export_network": "library",
    "export_onnx": "library",
    "convert_opset": "graph.passes",
    "load_model": "sources.foreign.load",
    "single_precision": "graph.passes",
}


def __getattr__(name: str) -> object:
    """Load what needs the onnx package at its first use, so that the command can say how to install it."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
