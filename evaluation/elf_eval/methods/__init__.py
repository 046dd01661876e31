"""Detectors and descriptors, each named by a text such as ``sift`` or ``elf:vgg.onnx?preset=paper``.

A new one is a `Method` in a file of its own and a row of `kinds.METHODS`; `xfeat` is an example.  May import `data`
(the images), and the runtime.
"""

from __future__ import annotations

from .kinds import METHODS, open_method, open_methods
from .method import Composed, Method

__all__ = ["METHODS", "Composed", "Method", "open_method", "open_methods"]
