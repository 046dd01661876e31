"""The tiny model, opened once for each file of tests."""

from __future__ import annotations

import pytest

from elf_runtime import ElfRuntime
from helpers import TINY


@pytest.fixture(scope="module")
def elf() -> ElfRuntime:
    return ElfRuntime(TINY, threads=1)
