"""Rewrites of a graph; one idea a file.

A pass edits the `Graph` that it is given, and returns it, so that a chain of passes makes one copy: where the graph is
made.  Its docstring says what it requires, when to call it, and what it ensures.  `cut`, `convert_opset`,
`single_precision` and `without_rounding` take a ModelProto and return a new one.  May import `graph` and errors.
"""

from __future__ import annotations

from .average_pools import average_pools
from .compose_convs import compose_convs
from .convert_opset import OPSETS, convert_opset, opset_of, require_opset, target_opset
from .convolve_averages import convolve_averages
from .cut import cut
from .expand_response import expand_response
from .factor_convs import factor_convs
from .fold_batchnorm import fold_batchnorm
from .fold_constants import fold_constants
from .pad_behind import pad_behind
from .portable_forms import portable_forms
from .project import project
from .rename_values import rename_values
from .share import share
from .share_row_maxima import share_row_maxima
from .shrink_image import shrink_image
from .single_precision import single_precision
from .sort_nodes import sort_nodes
from .standard_ops import standard_ops
from .without_rounding import without_rounding

__all__ = [
    "OPSETS",
    "average_pools",
    "compose_convs",
    "convert_opset",
    "convolve_averages",
    "cut",
    "expand_response",
    "factor_convs",
    "fold_batchnorm",
    "fold_constants",
    "opset_of",
    "pad_behind",
    "portable_forms",
    "project",
    "rename_values",
    "require_opset",
    "share",
    "share_row_maxima",
    "shrink_image",
    "single_precision",
    "sort_nodes",
    "standard_ops",
    "target_opset",
    "without_rounding",
]
