"""The adjoint of an ONNX graph, built from a rule table; see `engine.build_adjoint` and `registry.adjoint`."""

from __future__ import annotations

from . import activation, conv, elementwise, normalization, pool, structure  # noqa: F401  (they register rules)
from .engine import build_adjoint, nodes_between
from .registry import Context, Gradients, adjoint, no_gradient, supported_ops

__all__ = ["Context", "Gradients", "adjoint", "build_adjoint", "no_gradient", "nodes_between", "supported_ops"]
