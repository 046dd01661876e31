"""A sheet that shows how keypoints came about: image, keypoints, numbers, and the maps of each working scale."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.image.file import ImageLike

from .canvas import DARK, WHITE, Picture, circle, drawable, side_by_side, stacked, strength_colors, titled, write
from .chart import histogram_chart
from .render import displayable, draw_scaled, fitted, heatmap
from .source import pixels_of

if TYPE_CHECKING:
    from elf_runtime.results.trace import Level, Trace

_LEAST = (440, 330)  # width and height that charts and numbers need
_MASKED = (90, 90, 90)
_LINE = 24  # pixels from one line of text to the next


def draw_explanation(image: ImageLike, trace: Trace, title: str = "", color: str = "bgr") -> Picture:
    """How the keypoints of an image came about, on one sheet.

    The first row has the image, the keypoints on it (colours by rank, from weak to strong; rings grow with the sizes),
    and the numbers.  Each working scale, the finest first, has a row of its own: the saliency, the map that the level
    is chosen from with the level's contour, and the histogram of that map with the level and the entropy that Kapur's
    level maximises.  What a mask or alpha leaves out is grey.  In a grid, whose cells have levels of their own, it is
    the denoised map with the edge of what passed.

    Parameters
    ----------
    image : array or path, as `ElfRuntime.trace` takes it
        The one that the trace came from.
    trace : Trace
    title : str
        The image's name, for the sheet.
    color : "bgr" or "rgb"
        The order of an array's channels.

    Returns
    -------
    (h, w, 3) uint8
        In BGR.  An image of more than 800 pixels is shrunk to that, a tiny one enlarged.

    Raises
    ------
    ImageError, SettingError
        As `draw_keypoints`.
    """
    features = trace.features
    view, factor = fitted(displayable(pixels_of(image, features, color)))
    rings = draw_scaled(view, factor, features)
    height, width = features.image_size
    first = [
        titled(view, title, f"image {width}x{height}"),
        titled(rings, "keypoints", f"{len(features)}", legend=True),
        titled(_numbers(trace, _chart_size(view)), "numbers"),
    ]
    return stacked([side_by_side(first), *(side_by_side(_of_level(level, view)) for level in trace.levels)])


def _of_level(level: Level, view: Picture) -> list[Picture]:
    """Saliency, blurred map and histogram of a working scale."""
    size = (view.shape[1], view.shape[0])
    h, w = level.saliency.shape
    saliency = cv2.resize(heatmap(level.saliency), size, interpolation=cv2.INTER_LINEAR)
    blurred = level.scores if level.smooth is None else level.smooth
    if math.isnan(level.threshold):
        name, bound = "denoised", "each cell has a level of its own"
        passed = cv2.resize(level.mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) >= 0.5
    else:
        name, bound = "blurred for the level", f"contour at {level.threshold:g}"
        wide = cv2.resize(blurred, size, interpolation=cv2.INTER_LINEAR)
        passed = wide >= level.threshold if level.threshold > 0 else wide > 0
    heat = heatmap(blurred)
    if level.allowed is not None:
        bound += ", grey where the mask lets none be"
        heat[~level.allowed] = _MASKED
        passed &= cv2.resize(level.allowed.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    chart = histogram_chart(blurred, level.histogram, level.threshold, _chart_size(view))
    return [
        titled(np.asarray(saliency, np.uint8), "saliency S = |F^T dF/dI|", f"{w}x{h}"),
        titled(_outlined(heat, passed), name, bound),
        titled(chart, f"histogram, scale {level.scale:.3g}"),
    ]


def _outlined(heat: Picture, passed: npt.NDArray[np.bool_]) -> Picture:
    """The heat map at the size of `passed`, with a line around what passed."""
    height, width = passed.shape
    picture = np.asarray(cv2.resize(heat, (width, height), interpolation=cv2.INTER_LINEAR), np.uint8)
    lines, _ = cv2.findContours(passed.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(picture, lines, -1, WHITE, 1, cv2.LINE_AA)
    return picture


def _chart_size(view: Picture) -> tuple[int, int]:
    """(height, width) of charts and numbers: those of the image where they are readable at that size."""
    return max(view.shape[0], _LEAST[1]), max(view.shape[1], _LEAST[0])


def _numbers(trace: Trace, size: tuple[int, int]) -> Picture:
    """The sheet's numbers, with the legend of colours and sizes."""
    lines = _lines(trace)
    height = max(size[0], (len(lines) + 1) * _LINE + 110)
    panel = np.full((height, size[1], 3), DARK, np.uint8)
    for number, text in enumerate(lines):
        write(panel, drawable(text), 16, (number + 1) * _LINE)
    if len(trace.features):
        _legend(panel, trace, (len(lines) + 1) * _LINE)
    return panel


def _lines(trace: Trace) -> list[str]:
    features = trace.features
    lines = [f"{len(features)} keypoints, suppressed within {features.nms_radius:g} pixels"]
    if len(features):
        lines.append(f"scores {features.scores.min():.4g} to {features.scores.max():.4g}")
    for level in trace.levels:
        h, w = level.saliency.shape
        own = "levels of the cells" if math.isnan(level.threshold) else f"level {level.threshold:g}"
        lines.append(f"scale {level.scale:.3g} ({w}x{h}): {own}, {100 * float(level.mask.mean()):.1f} % pass")
    lines.append("")
    lines += [f"{1e3 * seconds:7.1f} ms  {stage}" for stage, seconds in trace.seconds.items()]
    return lines


def _legend(panel: Picture, trace: Trace, top: int) -> None:
    """A bar of the ranks' colours with the scores at its ticks, and a ring for each size."""
    scores, width = np.sort(trace.features.scores), panel.shape[1] - 100
    write(panel, "score", 16, top + 14)
    panel[top : top + 18, 80 : 80 + width] = np.array(strength_colors(width)[::-1], np.uint8)
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        x = 80 + round(share * (width - 1))
        panel[top + 18 : top + 23, x] = WHITE
        text = f"{np.quantile(scores, share):.3g}"
        write(panel, text, min(x - 4 * len(text), panel.shape[1] - 11 * len(text)), top + 40)
    write(panel, "size", 16, top + 80)
    sizes = np.unique(trace.features.sizes)
    for number, size in enumerate(sizes):
        x = 96 + number * 80
        circle(panel, x, top + 75, 4.0 * float(size / sizes[0]) if sizes[-1] < 6 * sizes[0] else 4.0, WHITE, 1)
        write(panel, f"{size:.3g}", x + 26, top + 80)
