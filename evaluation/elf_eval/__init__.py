"""Evaluation of keypoint detectors and descriptors: the ELF paper's protocol, and what is used today.

datasets -> methods -> extraction -> pair_metrics -> runner -> results -> report, compare, sweep.
"""

from __future__ import annotations

import elf_runtime  # noqa: F401  (first: it prepares OpenCV and ONNX Runtime)

from .errors import EvalError
from .features import LocalFeatures
from .protocol import Protocol

__all__ = ["EvalError", "LocalFeatures", "Protocol"]
