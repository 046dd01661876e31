"""Whether two ways to run a model find the same keypoints, and the paper's two metrics of a pair of images.

`compare` is public.  May import the engine and all below it.
"""

from __future__ import annotations

from .agreement import compare

__all__ = ["compare"]
