"""Sub-pixel places, as `elf_runtime.detection.refine` has them."""

from __future__ import annotations

import numpy as np

from elf_runtime.detection.refine import FARTHEST, FLAT

from .emit import DOUBLE, INT64, Emit, f64, i64
from .levels import rounded


def quadratic_peaks(e: Emit, scores: str, x: str, y: str, size: tuple[str, str]) -> tuple[str, str]:
    """The tops of quadratic surfaces through scores, (1, 1, h, w), and those around: x and y, (K,) float64 each.

    Parameters
    ----------
    x, y : (K,) int64
    size : (int64 (), int64 ())
        Height and width.
    """
    h, w = size
    near = _around(e, e.flat(scores), x, y, h, w)  # (K, 3, 3), [row][column]
    ranks, around = rounded(e, near), e.cast(near, DOUBLE)

    def at(row: int, column: int, values: str = around) -> str:
        picked = e(
            "Slice", values, np.array([row, column], i64), np.array([row + 1, column + 1], i64), np.array([1, 2], i64)
        )
        return e.flat(picked)

    def highest(values: str) -> str:
        most = e("ReduceMax", values, axes=[1, 2], keepdims=0)
        return e("Not", e("Greater", most, at(1, 1, ranks)))

    centre = at(1, 1)
    flat = e("Mul", centre, f64(-FLAT))
    slopes, curvatures, single = [], [], []
    inside = []
    for axis, (before, after, place, length) in enumerate(((at(1, 0), at(1, 2), x, w), (at(0, 1), at(2, 1), y, h))):
        slope = e("Mul", e("Sub", after, before), f64(0.5))
        curvature = e("Add", e("Sub", before, e("Mul", centre, f64(2))), after)
        free = e("And", e("Greater", place, i64(0)), e("Less", place, e("Sub", length, i64(1))))
        down = e("Less", curvature, flat)
        line = e("Slice", ranks, np.array([1], i64), np.array([2], i64), np.array([1 + axis], i64))
        parabola = _held(e, e("Div", e("Neg", slope), e("Where", down, curvature, f64(-1))))
        slopes.append(slope)
        curvatures.append(curvature)
        inside.append(free)
        single.append(e("Where", e.both(free, down, highest(line)), parabola, f64(0)))
    mixed = e("Sub", e("Add", at(0, 0), at(2, 2)), e("Add", at(0, 2), at(2, 0)))
    mixed = e("Mul", mixed, f64(0.25))
    determinant = e("Sub", e("Mul", *curvatures), e("Mul", mixed, mixed))
    curved = e("Greater", determinant, e("Mul", flat, e("Add", *curvatures)))
    topped = e.both(*inside, highest(ranks), *(e("Less", c, f64(0)) for c in curvatures), curved)
    moved = []
    for axis, place in ((0, x), (1, y)):
        towards = e("Sub", e("Mul", mixed, slopes[1 - axis]), e("Mul", curvatures[1 - axis], slopes[axis]))
        top = _held(e, e("Div", towards, e("Where", topped, determinant, f64(1))))
        moved.append(e("Add", e.cast(place, DOUBLE), e("Where", topped, top, single[axis])))
    return moved[0], moved[1]


def _held(e: Emit, step: str) -> str:
    return e("Min", e("Max", step, f64(-FARTHEST)), f64(FARTHEST))


def _around(e: Emit, flat: str, x: str, y: str, h: str, w: str) -> str:
    """(K, 3, 3): the values around places, those beyond the map being its outermost ones."""
    steps = np.array([-1, 0, 1], i64)
    columns, rows = (
        e("Min", e("Max", e("Add", e.column(at), steps), i64(0)), e("Sub", n, i64(1))) for at, n in ((x, w), (y, h))
    )
    index = e("Add", e("Mul", e("Unsqueeze", rows, np.array([2], i64)), w), e("Unsqueeze", columns, np.array([1], i64)))
    return e("Gather", flat, index)


def split(e: Emit, flat: str, w: str) -> tuple[str, str]:
    """Flat places as x and y, (K,) int64 each."""
    y = e.cast(e("Div", flat, w), INT64)
    return e("Sub", flat, e("Mul", y, w)), y
