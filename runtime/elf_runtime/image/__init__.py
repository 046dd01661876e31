"""An image: read from a file, brought to the pixels that a graph takes, and what of it is image at all (masks).

May import the contract, `files` and errors.
"""

from __future__ import annotations

from .file import read

__all__ = ["read"]
