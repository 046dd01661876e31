"""Freed memory, back to the system."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any


def trim_heap() -> None:
    """Give the C library's free pages back to the system, where it is glibc, which keeps them; else nothing.

    Buffers of ever other sizes, taken and freed, leave glibc's heap in pieces: what a process holds grows to several
    times what it uses.  A trim takes about half a millisecond.
    """
    trim = _malloc_trim()
    if trim is not None:
        trim(0)


@cache
def _malloc_trim() -> Any:
    try:
        return ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):  # musl, macOS; Windows names no library by None
        return None
