"""The one error that the evaluation raises on purpose, and the system's errors in the same words."""

from __future__ import annotations

from elf_runtime.errors import ElfError
from elf_runtime.errors import reason as reason


class EvalError(ElfError):
    """What was wrong (file, pair, option), what was expected, and what to do next; a line for each of several."""

    has_rows = True
