"""Where PyInstaller finds this package's hook; it asks by the entry point `hook-dirs` (pyproject.toml)."""

from __future__ import annotations

from pathlib import Path


def get_hook_dirs() -> list[str]:
    return [str(Path(__file__).parent)]
