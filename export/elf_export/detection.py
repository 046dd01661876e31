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
    return {name: value for name, value in vars(detection).items() if value != getattr(own, name)}
