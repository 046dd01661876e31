"""ELF's detection settings as text, for methods and sweeps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from .spec import Spec, boolean


def _blur(text: str) -> tuple[int, float]:
    mu, _, sigma = text.partition(",")
    return int(mu), float(sigma)


def _threshold(text: str) -> str | float:
    return text if text in ("kapur", "none") else float(text)


# max_keypoints is the protocol's, the same for every method.
CONVERTERS: Mapping[str, Callable[[str], Any]] = MappingProxyType(
    {
        "denoise": _blur,
        "threshold_blur": _blur,
        "threshold": _threshold,
        "nms_radius": int,
        "border": int,
        "scale": float,
        "quantize": boolean,
        "subpixel": boolean,
        "normalize": float,
    }
)


def detection_changes(spec: Spec) -> dict[str, Any]:
    """The fields of `elf_runtime.DetectionParams` that a text gives, e.g. ``denoise=5,2&scale=0.5``."""
    changes = {name: spec.take(name, convert, None) for name, convert in CONVERTERS.items()}
    return {name: value for name, value in changes.items() if value is not None}
