"""`ElfRuntime`: a model in, keypoints and descriptors out; `ElfFeature2D`: the same as one of OpenCV's detectors.

May import every room but those above it: `checks`, `timing` and `commands`.
"""

from __future__ import annotations

from .feature2d import ElfFeature2D
from .runtime import ElfRuntime

__all__ = ["ElfFeature2D", "ElfRuntime"]
