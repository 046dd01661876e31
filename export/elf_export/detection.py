"""The detection settings that a file carries, and the options that say them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from elf_runtime import DetectionParams
from elf_runtime.errors import SettingError

from .errors import ExportError

Wanted = DetectionParams | Mapping[str, Any] | None
"""All settings, some to change, or None: the network's own."""


def chosen(own: DetectionParams, wanted: Wanted) -> DetectionParams:
    """The settings for a file.

    Raises
    ------
    ExportError
        On an unknown setting, or a value out of range.
    """
    if isinstance(wanted, DetectionParams):
        return wanted
    try:
        return own.updated(**(wanted or {}))
    except SettingError as error:
        raise ExportError(str(error)) from error


def arguments(own: DetectionParams, detection: DetectionParams) -> list[str]:
    """`elf-export`'s options for what differs from the network's own settings."""
    return [word for setting in detection.to_words(own) for word in ("--set", setting)]
