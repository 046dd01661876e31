"""Evaluation of keypoint detectors and descriptors: the ELF paper's protocol, and what is used today.

data -> methods -> metrics -> suite -> run -> bench -> report -> command.  Each room may import those before it, and
the modules beside this file.  Public in Python is what a method of your own needs, `plugin:` of
evaluation/README.md; for all else use the `elf-eval` command.
"""

from __future__ import annotations

import elf_runtime  # noqa: F401  (first: it prepares OpenCV and ONNX Runtime)

from .errors import EvalError
from .features import LocalFeatures
from .protocol import Protocol

__all__ = ["EvalError", "LocalFeatures", "Protocol"]
