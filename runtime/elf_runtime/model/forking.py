"""Processes that are forked while models are open.

A session of ONNX Runtime has threads, and a forked child has none of its parent's: to destroy such a session there
would wait for its threads forever.  So a child never destroys the sessions that it inherits, whoever drops them, and
opens its own in their place.
"""

from __future__ import annotations

import ctypes
import os
import threading
import weakref
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

Opened = TypeVar("Opened")


class Holder(Protocol):
    """An object that keeps sessions."""

    def forget(self) -> None:
        """Give up all sessions: this is a child that has just been forked, and has one thread."""


_sessions: weakref.WeakSet[Any] = weakref.WeakSet()
_holders: weakref.WeakSet[Holder] = weakref.WeakSet()
# A fork waits while a session is being opened: the locks that ONNX Runtime holds then would stay locked in the child.
_opening = threading.RLock()


def opened(make: Callable[[], Opened]) -> Opened:
    """The session that `make` opens, safe to be inherited by a forked process."""
    with _opening:
        session = make()
        _sessions.add(session)
    return session


def forgets_when_forked(holder: Holder) -> None:
    """Have the holder's `forget` called in every forked child."""
    _holders.add(holder)


def _in_child() -> None:
    global _opening
    _opening = threading.RLock()
    for session in list(_sessions):
        # A reference that nobody drops, not even the interpreter at its end.
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(session))
    _sessions.clear()
    for holder in list(_holders):
        holder.forget()


if hasattr(os, "register_at_fork"):
    # Looked up when they are called: `_opening` is another lock in a child.
    os.register_at_fork(
        before=lambda: _opening.acquire(), after_in_parent=lambda: _opening.release(), after_in_child=_in_child
    )
