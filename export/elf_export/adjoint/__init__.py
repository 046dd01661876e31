"""The adjoint of an ONNX graph: `engine` walks it backwards and asks the rules, of which `registry` has the table.

`rules` holds the rules, a file for each family.  They say what is true, in standard operations and those of `dialect`;
forms that are fast somewhere are `lowering`'s.
May import `dialect`, `graph` and errors; nothing here knows of keypoints.
"""

from __future__ import annotations

from . import rules as rules  # registers them
from .engine import build_adjoint
from .path import nodes_between
from .preflight import opset_wanted, unsupported_behind
from .registry import Context, Gradients, adjoint, no_gradient, supported_ops

__all__ = [
    "Context",
    "Gradients",
    "adjoint",
    "build_adjoint",
    "no_gradient",
    "nodes_between",
    "opset_wanted",
    "supported_ops",
    "unsupported_behind",
]
