"""The one error that the evaluation raises on purpose, and the system's in the same words."""

from __future__ import annotations

from elf_runtime.errors import reason as reason


class EvalError(Exception):
    """What was wrong (file, pair, option), what was expected, and what to do next."""


def explained(error: BaseException) -> str:
    """`reason`, behind the file where an OSError has one."""
    file = error.filename if isinstance(error, OSError) else None
    return f"{file}: {reason(error)}" if file else reason(error)
