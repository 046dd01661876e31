"""The histogram of a map as a chart, with the level that splits it and the entropy that Kapur's level maximises."""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.entropy import class_entropies

from .canvas import DARK, WHITE, Color, Picture, text_width, write

BELOW: Color = (130, 90, 60)
ABOVE: Color = (235, 235, 120)
ENTROPY: Color = (90, 210, 60)
LEVEL: Color = (80, 80, 235)
_BINS = 256


def histogram_chart(
    values: npt.NDArray[np.float32], counts: npt.NDArray[np.float32] | None, level: float, size: tuple[int, int]
) -> Picture:
    """Bars of a histogram on a logarithmic scale: those below the level dim, those above it bright.

    Parameters
    ----------
    values : (h, w) float32, 0 to 255, beyond it in the last bin
        What is counted where there are no `counts`.
    counts : (256,) float32, optional
        The histogram that Kapur's level is chosen from: with it, H(t) is drawn between its own extremes.
    level : float
        NaN is none.
    size : (height, width)
    """
    height, width = size
    chart = np.full((height, width, 3), DARK, np.uint8)
    left, top, bottom = 20, 64, height - 34
    shown = np.histogram(np.minimum(values, 255), _BINS, (0, _BINS))[0] if counts is None else counts
    heights = np.log1p(shown) / max(float(np.log1p(shown.max())), 1.0)
    step = (width - 2 * left) / _BINS
    for i, share in enumerate(heights):
        color = ABOVE if math.isnan(level) or i >= level else BELOW
        a, b = left + round(i * step), left + max(round((i + 1) * step) - 1, round(i * step))
        if share > 0:
            cv2.rectangle(chart, (a, bottom), (b, bottom - round(share * (bottom - top))), color, -1)
    for tick in (0, 64, 128, 192, 255):
        x = left + round(tick * step)
        chart[bottom : bottom + 6, x] = WHITE
        write(chart, str(tick), min(x - text_width(str(tick)) // 2, width - text_width(str(tick)) - 4), bottom + 24)
    chart[bottom, left : width - left] = WHITE
    write(chart, f"pixels (log), at most {int(shown.max())} in a bin", left, 24)
    if counts is not None:
        _draw_entropy(chart, class_entropies(counts), (left, top, bottom), step)
    if not math.isnan(level):
        x = left + round(min(level, _BINS) * step)
        cv2.line(chart, (x, top - 10), (x, bottom), LEVEL, 2)
        text = f"level {level:g}"
        write(chart, text, width - left - text_width(text), 24, LEVEL)
    return chart


def _draw_entropy(chart: Picture, entropy: npt.NDArray[np.float64], frame: tuple[int, int, int], step: float) -> None:
    """H(t) as a line, each t at the edge between its bin and the next, where the classes part."""
    left, top, bottom = frame
    known = np.flatnonzero(np.isfinite(entropy))
    if known.size < 2:
        return
    values = entropy[known]
    span = max(float(np.ptp(values)), 1e-9)
    x = left + (known + 1) * step
    y = bottom - (values - values.min()) / span * (bottom - top)
    cv2.polylines(chart, [np.rint(np.stack([x, y], axis=1)).astype(np.int32)], False, ENTROPY, 2, cv2.LINE_AA)
    text = f"entropy H(t) of both classes: {values.min():.2f} to {values.max():.2f}"
    write(chart, text, left, 46, ENTROPY)
