"""`ElfRuntime`: a model's file in, keypoints, scores and descriptors out.

May import every room but those above it: `checks`, `pictures`, `timing` and `commands`.
"""

from __future__ import annotations

from .runtime import ElfRuntime

__all__ = ["ElfRuntime"]
