"""Rewrites of a model; one idea a file.  Each takes a ModelProto and returns a new one."""

from __future__ import annotations

from .compose_convs import compose_convs
from .cut import cut
from .fold_batchnorm import fold_batchnorm
from .fold_constants import fold_constants
from .share import share

__all__ = ["compose_convs", "cut", "fold_batchnorm", "fold_constants", "share"]
