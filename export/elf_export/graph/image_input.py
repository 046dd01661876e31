"""The image input of a network."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ImageInput:
    """The image input of a network.

    Attributes
    ----------
    name : str
    layout : "NCHW" or "NHWC"
    channels : 1 or 3
    size : (N, H, W)
        As the file states them: an int where fixed, None where free.
    """

    name: str
    layout: str
    channels: int
    size: tuple[int | None, int | None, int | None]
