"""ELF's detection settings as they are written in a method's text and on a sweep's grid."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from elf_eval.spec import Spec, boolean


def _blur(text: str) -> tuple[int, float]:
    mu, _, sigma = text.partition(",")
    return int(mu), float(sigma)


def _threshold(text: str) -> str | float:
    return text if text in ("kapur", "none") else float(text)


# Without max_keypoints, which the protocol sets for every method alike.
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
