"""Is an exported graph right?  Held against torch.autograd, central differences, and its own float32 form.

May import `saliency`, `graph`, preprocessing and calibration; knows nothing of where a network came from.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from elf_export.errors import VerificationError


class Check(Protocol):
    """What holding a graph against an independent computation has shown."""

    @property
    def passed(self) -> bool: ...

    @property
    def complaint(self) -> str:
        """What is wrong if it has not passed, with the bounds; a sentence or two."""

    def table(self) -> str:
        """The comparison as a small text table."""

    def figures(self) -> dict[str, float]:
        """What the contract says of it, under `elf.parity`."""


def require(check: Check, log: Callable[[str], None] = lambda _: None) -> None:
    """Log a check's table.

    Raises
    ------
    VerificationError
        If it has not passed.
    """
    if not check.passed:
        raise VerificationError(f"{check.complaint} No file was written.\n{check.table()}")
    log(check.table())
