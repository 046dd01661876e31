"""What a run says of one image, whichever engine did it: the record of its features, and what became of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from elf_runtime.errors import printable
from elf_runtime.results.trace import Trace
from elf_runtime.version import __version__

from .frames import Frame, Opened


def record_of_image(settings: Mapping[str, Any], frame: Frame, image: Opened) -> dict[str, Any]:
    """The record of model and `settings` with that of the image, by which its features are known again."""
    return {**settings, **frame.identity(), "image_sha256": image.sha256, "elf-onnx": __version__}


def failure(frame: Frame, error: Exception) -> dict[str, Any]:
    """Of an image that could not be done: why, beginning with its name."""
    name = printable(frame.name)
    named = str(error).startswith(f"{name}:")
    return {**frame.told(), "error": str(error) if named else f"{name}: {error}"}


def detected(frame: Frame, files: Sequence[str], trace: Trace, seconds: float, read: float) -> dict[str, Any]:
    """Of an image that is done; `seconds` were for all of it, `read` of them for reading and decoding."""
    return {
        **frame.told(),
        "files": list(files),
        "size": list(trace.features.image_size),
        "keypoints": len(trace.features),
        "passed": float(trace.mask.mean()) if trace.levels else None,
        "seconds": seconds,
        "stages": trace.seconds | {"read": read},
        "skipped": False,
    }
