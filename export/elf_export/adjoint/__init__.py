"""The adjoint of an ONNX graph, from a table of rules; see `engine.build_adjoint` and `registry.adjoint`."""

from __future__ import annotations

from . import rules as rules  # registers them
from .engine import adjoint_parts, build_adjoint, nodes_between, opset_wanted, unsupported_behind
from .registry import Context, Gradients, adjoint, no_gradient, supported_ops

__all__ = [
    "Context",
    "Gradients",
    "adjoint",
    "adjoint_parts",
    "build_adjoint",
    "no_gradient",
    "nodes_between",
    "opset_wanted",
    "supported_ops",
    "unsupported_behind",
]
