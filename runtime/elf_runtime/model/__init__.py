"""A model file: found, opened in a session of ONNX Runtime, run, and read without the onnx package.

May import the contract, `files` and errors; nothing here knows of images or keypoints.
"""

from __future__ import annotations

from .bundled import bundled_model
from .subgraph import with_outputs

__all__ = ["bundled_model", "with_outputs"]
