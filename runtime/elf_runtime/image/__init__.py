"""Images: read from files, converted to the pixels that a graph takes, and masked where no keypoint may be.

`read` is public.  May import the contract, `files` and errors.
"""

from __future__ import annotations

from .file import read

__all__ = ["read"]
