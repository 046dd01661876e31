"""Model files: found, opened in sessions of ONNX Runtime, run, and read without the onnx package.

`bundled_model` and `with_outputs` are public.  May import the contract, `params`, `files` and errors; nothing here
knows of image files or keypoints.
"""

from __future__ import annotations

from .bundled import bundled_model
from .subgraph import with_outputs

__all__ = ["bundled_model", "with_outputs"]
