"""Detection settings as NAME=VALUE on a command line."""

from __future__ import annotations

import argparse
from typing import Any


def setting(text: str) -> tuple[str, Any]:
    """An argparse type, of any name: "scale=0.5", "denoise=5,1.2", "subpixel=true"."""
    name, equals, value = text.partition("=")
    parts = [_plain(part) for part in value.split(",")]
    if not equals or not name or "" in parts:
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    return name.strip(), parts[0] if len(parts) == 1 else tuple(parts)


def _plain(text: str) -> Any:
    """A number, true or false, or the text itself."""
    text = text.strip()
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text
