"""Whether two ways to run a model find the same keypoints, and statistics of timings.

May import everything but `commands`.
"""

from __future__ import annotations

from .agreement import compare

__all__ = ["compare"]
