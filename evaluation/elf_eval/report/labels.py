"""Labels beside points that cover neither one another nor a point, a line or the legend."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

_MARKER = 7.0  # half a marker's box, in points
_CELL = 4.0  # a line is held against a label every so many points


def place_labels(
    axes: Any,
    points: Sequence[tuple[float, float]],
    texts: Sequence[str],
    lines: Sequence[Any] = (),
    size: float = 8.5,
) -> list[Any]:
    """Annotate points of a matplotlib axes, each at the free place nearest to it.

    Parameters
    ----------
    points : sequence of (x, y)
        In the axes' data; limits and scales are set before.
    lines : sequence of Line2D
        What no label may lie on.
    size : float
        Font size in points.

    Returns
    -------
    list of Annotation, in the order of the points
    """
    figure = axes.figure
    figure.canvas.draw()  # places the axes, and with it everything inside
    renderer = figure.canvas.get_renderer()
    unit = figure.dpi / 72.0
    where = axes.transData.transform(np.asarray(points, float))
    taken = [_around(x, y, _MARKER * unit) for x, y in where]
    for line in lines:
        taken += [_around(x, y, unit) for x, y in _along(line, _CELL * unit)]
    legend = axes.get_legend()
    if legend is not None:
        box = legend.get_window_extent(renderer)
        taken.append((box.x0, box.y0, box.x1, box.y1))
    inside = axes.get_window_extent(renderer)
    placed = []
    for (x, y), text, at in zip(points, texts, where, strict=True):
        note = axes.annotate(
            text, (x, y), xytext=(0, 0), textcoords="offset points", fontsize=size, linespacing=1.05,
            ha="center", va="center", zorder=4,
        )  # fmt: skip
        box = note.get_window_extent(renderer)
        half = np.array([box.width, box.height]) / 2.0 + unit
        offset, best = np.zeros(2), np.inf
        for candidate in _places(half, _MARKER * unit):
            x0, y0 = at + candidate - half
            x1, y1 = at + candidate + half
            outside = x0 < inside.x0 or y0 < inside.y0 or x1 > inside.x1 or y1 > inside.y1
            cover = sum(_overlap((x0, y0, x1, y1), other) for other in taken) + 1e6 * outside
            if cover < best:
                offset, best = candidate, cover
            if best == 0.0:
                break
        note.set_position(tuple(offset / unit))
        taken.append((*(at + offset - half), *(at + offset + half)))
        gap = np.maximum(np.abs(offset) - half, 0.0)
        if np.hypot(*gap) > 2.0 * _MARKER * unit:
            axes.annotate(
                "", (x, y), xytext=tuple((offset - np.clip(offset, -half, half)) / unit), textcoords="offset points",
                arrowprops={"arrowstyle": "-", "color": "#999999", "linewidth": 0.8, "shrinkB": 5}, zorder=2,
            )  # fmt: skip
        placed.append(note)
    return placed


def _places(half: Any, gap: float) -> Iterator[Any]:
    """Offsets of a label's centre from its point, near ones first: right, left, above, below, then between."""
    for distance in (0.0, 0.6, 1.5, 3.0, 5.0, 8.0, 12.0):
        reach = gap * (1.0 + distance)
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1)):
            yield np.array([x, y]) * (half + reach * (0.5 if x and y else 1.0))


def _along(line: Any, step: float) -> Any:
    """(N, 2) pixels along a line as drawn, at most `step` apart."""
    path = line.get_transform().transform_path(line.get_path()).vertices
    parts = []
    for a, b in pairwise(path):
        count = max(2, int(np.hypot(*(b - a)) / step) + 1)
        parts.append(a + np.linspace(0.0, 1.0, count)[:, None] * (b - a))
    return np.concatenate(parts) if parts else np.zeros((0, 2))


def _around(x: float, y: float, half: float) -> tuple[float, float, float, float]:
    return x - half, y - half, x + half, y + half


def _overlap(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    """Area that two boxes (x0, y0, x1, y1) share."""
    width, height = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    return max(0.0, width) * max(0.0, height)
