"""What notebooks show of results: PNG pictures, on the image that the record names, or on a blank canvas."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from .canvas import Picture, titled
from .render import detection_panels, displayable, draw_scaled, fitted, panel_size
from .source import recorded_pixels

if TYPE_CHECKING:
    from elf_runtime.results.features import Features
    from elf_runtime.results.trace import Trace

_BLANK = 110  # grey, so that keypoints of all strengths are seen


def features_png(features: Features) -> bytes:
    """The keypoints on their image."""
    height, width = features.image_size
    counts = f"{len(features)} keypoints, image {width}x{height}"
    return _png(titled(draw_scaled(*_view(features), features), "", counts, legend=True))


def trace_png(trace: Trace) -> bytes:
    """Keypoints, saliency and threshold side by side."""
    return _png(detection_panels(*_view(trace.features), trace))


def _view(features: Features) -> tuple[Picture, float]:
    """The image, or a blank canvas, as large as in its panel, and by which factor that is of the image's size."""
    pixels = recorded_pixels(features)
    if pixels is not None:
        return fitted(displayable(pixels))
    (height, width), factor = panel_size(*features.image_size)
    return np.full((height, width, 3), _BLANK, np.uint8), factor


def _png(picture: Picture) -> bytes:
    return bytes(cv2.imencode(".png", picture)[1].tobytes())
