"""Detectors and descriptors, each by a text such as ``sift`` or ``elf:vgg.onnx?preset=paper``."""

from __future__ import annotations

from .base import Composed, Method
from .registry import METHODS, open_method, open_methods

__all__ = ["METHODS", "Composed", "Method", "open_method", "open_methods"]
