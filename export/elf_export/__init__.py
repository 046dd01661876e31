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
from .export import export_network
from .foreign.export import export_onnx
from .foreign.load import load_model
from .output import ExportResult
from .preprocessing import Preprocessing
from .saliency import build_gradient, build_saliency

__all__ = [
    "ExportError",
    "ExportResult",
    "LayerError",
    "Preprocessing",
    "UnsupportedGraphError",
    "UnsupportedNode",
    "VerificationError",
    "WeightsError",
    "build_gradient",
    "build_saliency",
    "export_network",
    "export_onnx",
    "load_model",
]
