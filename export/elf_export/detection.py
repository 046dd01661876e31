"""The detection settings that a file carries, and the options that say them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from elf_runtime import DetectionParams
from elf_runtime.errors import SettingError

from .errors import ExportError

Wanted = DetectionParams | Mapping[str, Any] | None
"""All settings, some to change, or None: the network's own."""


def as_mapping(wanted: Wanted) -> Mapping[str, Any]:
    """What is wanted, setting by setting."""
    return wanted.to_dict() if isinstance(wanted, DetectionParams) else wanted or {}


def chosen(own: DetectionParams, wanted: Wanted) -> DetectionParams:
    """The settings for a file.

    Raises
    ------
    ExportError
        On an unknown setting, or a value out of range.
    """
    try:
        return own.updated(**as_mapping(wanted))
    except SettingError as error:
        raise ExportError(str(error)) from error


def changed(own: DetectionParams, detection: DetectionParams) -> dict[str, Any]:
    """The settings of `detection` that are not those of `own`."""
    base = own.to_dict()
    return {name: value for name, value in detection.to_dict().items() if value != base[name]}


def setting_words(settings: Mapping[str, Any]) -> list[str]:
    """`elf-export`'s options for settings."""
    return [word for name, value in settings.items() for word in ("--set", f"{name}={_text(value)}")]


def _text(value: Any) -> str:
    if isinstance(value, (tuple, list)):
        return ",".join(map(_text, value))
    return str(value).lower() if isinstance(value, bool) else str(value)
