"""Builds ELF models: a CNN's forward pass and its explicit backward pass in one ONNX graph.

>>> from elf_export import export_network, build_saliency
>>> export_network("vgg", "pool2", ["pool4"], "elf-vgg-pool2.onnx")      # doctest: +SKIP
"""

from __future__ import annotations

from .errors import (
    ExportError,
    LayerError,
    UnsupportedGraphError,
    UnsupportedNode,
    VerificationError,
    WeightsError,
)
from .export import ExportResult, export_network
from .preprocessing import Preprocessing
from .saliency import build_saliency

__all__ = [
    "ExportError",
    "ExportResult",
    "LayerError",
    "Preprocessing",
    "UnsupportedGraphError",
    "UnsupportedNode",
    "VerificationError",
    "WeightsError",
    "build_saliency",
    "export_network",
]
