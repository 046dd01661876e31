"""Labels beside points, which cover neither one another nor a point, a line or the legend."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from elf_eval.coordinates import Float

_MARKER = 7.0  # half a marker's box, in points
_CELL = 4.0  # a line is held against a label every so many points
_DISTANCES = (0.0, 0.6, 1.5, 3.0, 5.0, 8.0)  # from the nearest place, in half markers
# Where a label's centre lies, in halves of its size: beside the point, then slid along it, then at the corners.
_SIDES = (
    *((1, 0), (-1, 0), (0, 1), (0, -1)),
    *((1, 0.5), (1, -0.5), (-1, 0.5), (-1, -0.5), (0.5, 1), (-0.5, 1), (0.5, -1), (-0.5, -1)),
    *((1, 1), (-1, 1), (1, -1), (-1, -1)),
)
_ORDERS = 300


def place_labels(axes: Any, points: Sequence[tuple[float, float]], texts: Sequence[str], lines: Sequence[Any]) -> None:
    """Annotate the points of matplotlib axes, each label at a free place near its point.

    A label that is far away gets a thin line to its point.

    Parameters
    ----------
    points : sequence of (x, y)
        In data coordinates; the axes' limits and scales are set already.
    lines : sequence of Line2D
        What no label may lie on.
    """
    figure = axes.figure
    figure.canvas.draw()  # places the axes and all that is inside
    renderer = figure.canvas.get_renderer()
    unit = figure.dpi / 72.0
    at: Float = axes.transData.transform(np.asarray(points, float))
    notes = [
        axes.annotate(
            text, point, xytext=(0, 0), textcoords="offset points", fontsize=8.5, linespacing=1.05,
            ha="center", va="center", zorder=4,
        )
        for point, text in zip(points, texts, strict=True)
    ]  # fmt: skip
    extents = [note.get_window_extent(renderer) for note in notes]
    halves = np.array([(box.width, box.height) for box in extents]) / 2.0 + (3.0 * unit, unit)
    taken = [_around(at, _MARKER * unit), *(_around(_along(line, _CELL * unit), unit) for line in lines)]
    if axes.get_legend() is not None:
        taken.append(_box(axes.get_legend().get_window_extent(renderer))[None])
    inside = _box(axes.get_window_extent(renderer))
    offsets = np.stack([_places(half, _MARKER * unit) for half in halves])
    chosen = choose(at, halves, offsets, np.concatenate(taken), inside)
    for note, point, half, offset in zip(notes, points, halves, chosen, strict=True):
        note.set_position(tuple(offset / unit))
        if np.hypot(*np.maximum(np.abs(offset) - half, 0.0)) > 2.0 * _MARKER * unit:
            end = (offset - np.clip(offset, -half, half)) / unit
            axes.annotate(
                "", point, xytext=tuple(end), textcoords="offset points", zorder=2,
                arrowprops={"arrowstyle": "-", "color": "#999999", "linewidth": 0.8, "shrinkB": 5},
            )  # fmt: skip


def choose(at: Float, halves: Float, offsets: Float, taken: Float, inside: Float) -> Float:
    """An offset for each label: the one with the least overlap, and of several the nearest.

    Labels are placed one after the other, each at its best free place.  Many orders are tried, drawn from a fixed seed,
    and the best is kept.

    Parameters
    ----------
    at, halves : (N, 2)
        The points, and half of each label's width and height.
    offsets : (N, P, 2)
        Places of a label's centre from its point, good ones first.
    taken : (M, 4)
        Boxes x0, y0, x1, y1 that must stay free.
    inside : (4,)
        The box that no label may leave.

    Returns
    -------
    (N, 2)
    """
    centres = at[:, None] + offsets
    boxes = np.concatenate([centres - halves[:, None], centres + halves[:, None]], axis=2)
    outside = (boxes[..., :2] < inside[:2]).any(axis=2) | (boxes[..., 2:] > inside[2:]).any(axis=2)
    # A place further down the list costs less than a single pixel of overlap.
    fixed = np.arange(offsets.shape[1]) / offsets.shape[1] + 1e6 * outside
    fixed = fixed + np.stack([_overlap(own[:, None], taken).sum(axis=1) for own in boxes])
    rng = np.random.default_rng(0)
    best, least = np.zeros(len(at), int), np.inf
    for turn in range(_ORDERS):
        order = rng.permutation(len(at)) if turn else np.arange(len(at))
        places, total, others = np.zeros(len(at), int), 0.0, np.zeros((0, 4))
        for i in order:
            cost = fixed[i] + _overlap(boxes[i][:, None], others).sum(axis=1)
            places[i] = cost.argmin()
            total += cost[places[i]] ** 2 if cost[places[i]] < 1.0 else cost[places[i]]
            others = np.concatenate([others, boxes[i, places[i]][None]])
        if total < least:
            best, least = places, total
    return np.asarray(offsets[np.arange(len(at)), best])


def _places(half: Float, gap: float) -> Float:
    """(P, 2) offsets of a label's centre, near ones first."""
    sides = np.array(_SIDES, float)
    edges = np.where(np.abs(sides) == 1.0, np.sign(sides), 0.0)  # the gap is to the point's side alone
    edges[(edges != 0.0).all(axis=1)] *= 0.5
    return np.concatenate([sides * half + edges * gap * (1.0 + distance) for distance in _DISTANCES])


def _along(line: Any, step: float) -> Float:
    """(N, 2) pixels along a line, at most `step` apart."""
    path = line.get_transform().transform_path(line.get_path()).vertices
    parts = [
        a + np.linspace(0.0, 1.0, int(np.hypot(*(b - a)) / step) + 2)[:, None] * (b - a) for a, b in pairwise(path)
    ]
    return np.concatenate(parts)


def _around(centres: Float, half: float) -> Float:
    return np.concatenate([centres - half, centres + half], axis=1)


def _box(extent: Any) -> Float:
    return np.array([extent.x0, extent.y0, extent.x1, extent.y1])


def _overlap(a: Float, b: Float) -> Float:
    """Areas that boxes (..., 4) share."""
    sides = np.minimum(a[..., 2:], b[..., 2:]) - np.maximum(a[..., :2], b[..., :2])
    return np.asarray(np.maximum(sides, 0.0).prod(axis=-1))
