"""Exact greedy non-maximum suppression, and the strongest that it leaves, as `elf_runtime.detection.nms` has them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from .emit import FLOAT, INT64, Emit, f32, f64, i64

_MOST_ROUNDS = 1_000_000  # of the Loop: it ends when no candidate is left


@dataclass(frozen=True)
class Window:
    """The square window of suppression: `radius` working pixels to each side, up to `most` for small images.

    Attributes
    ----------
    wanted : str, optional
        int64 (), the radius for this image; None where it is `radius` for all.
    """

    radius: int
    most: int
    wanted: str | None = None

    @classmethod
    def of(cls, e: Emit, nms_radius: int, scale: float, seen: str, one_for_all: bool) -> Window:
        """Of a radius in source pixels at a working scale; `seen`, float64 (), is that of the image."""

        def at(s: float) -> int:
            return max(1, round(nms_radius * s)) if nms_radius else 0

        most = at(max(scale, 1.0))
        if one_for_all or most == at(scale):
            return cls(at(scale), at(scale))
        wanted = e.cast(e("Max", e("Round", e("Mul", seen, f64(nms_radius))), f64(1)), INT64)
        return cls(at(scale), most, wanted)

    def largest(self, e: Emit, x: str) -> str:
        """The largest value of the window around each pixel; (1, 1, h, w)."""
        plain = partial(_dilated, e, x, self.radius)
        if self.wanted is None:
            return plain()

        wanted = self.wanted

        def wider() -> str:
            found = plain()
            for radius in range(self.radius + 1, self.most + 1):
                found = e("Where", e("Less", wanted, i64(radius)), found, _dilated(e, found, 1))
            return found

        return e.either(e("Greater", wanted, i64(self.radius)), wider, plain)


def _dilated(e: Emit, x: str, radius: int) -> str:
    side = 2 * radius + 1
    x = e("MaxPool", x, kernel_shape=[1, side], pads=[0, radius, 0, radius])
    return e("MaxPool", x, kernel_shape=[side, 1], pads=[radius, 0, radius, 0])


def window_maxima(e: Emit, scores: str, window: Window) -> str:
    """(1, 1, h, w) bool: scores that no other exceeds in their window, whether these passed or not."""
    return e("Not", e("Less", scores, window.largest(e, scores)))


def greedy(e: Emit, scores: str, candidates: str, window: Window, rounds: int) -> str:
    """The candidates that the plain loop takes: (1, 1, h, w) float32, 1 where taken.

    The loop takes candidates by descending score, ties in raster order, and each suppresses the rest of its window.
    Whole rounds are taken at once: a candidate that precedes all others left in its window would be taken by the loop
    too.  The order is a number for each candidate, n for the first and 1 for the last, so that none are equal.

    Parameters
    ----------
    scores, candidates : (1, 1, h, w) float32 and bool
    rounds : int
        So many rounds, unrolled; 0: a Loop of as many as are needed, which is exact.
    """
    count = e("ReduceSum", e.cast(candidates, FLOAT), keepdims=0)
    n = e("Max", e.cast(count, INT64), i64(1))  # at least one, see `strongest`: of rank 0, it is not taken
    masked = e.flat(e("Where", candidates, scores, f32(-1)))
    _, order = e.top(masked, n, sort=True)  # equal ones by ascending place
    numbers = e("Sub", count, e.cast(e.count(n), FLOAT))
    ranks = e("ScatterElements", e("Mul", masked, f32(0)), order, numbers, axis=0)
    left = e("Reshape", ranks, e("Shape", scores))
    taken = e("Mul", left, f32(0))
    if rounds == 0:
        return _loop(e, left, taken, window)
    for _ in range(rounds):
        left, taken = _round(e, left, taken, window)
    return taken


def _round(e: Emit, left: str, taken: str, window: Window) -> tuple[str, str]:
    first = e.cast(e.both(e("Equal", left, window.largest(e, left)), e("Greater", left, f32(0))), FLOAT)
    covered = e("Greater", window.largest(e, first), f32(0))
    return e("Where", covered, f32(0), left), e("Max", taken, first)


def _loop(e: Emit, left: str, taken: str, window: Window) -> str:
    """As many rounds as are needed."""
    inner, before = e.name("left"), e.name("taken")

    def body() -> list[str]:
        rest, after = _round(e, inner, before, window)
        return [e("Greater", e("ReduceMax", rest, keepdims=0), f32(0)), rest, after]

    return e.loop(_MOST_ROUNDS, {inner: left, before: taken}, body)[1]


def strongest(e: Emit, scores: str, ranks: str, taken: str, most: str) -> tuple[str, str, str]:
    """Scores, (K,), descending, and flat places, (K,) int64, of the `most` taken of the highest ranks.

    Ranks, (1, 1, h, w), are the scores, `rounded`: of equal ones the first in raster order are kept.

    K is one at least, because OpenVINO 2026.4 ends a run without a word where steps have no rows, and leaves in the
    outputs what was there.  Third comes how many are keypoints, int64 ().
    """
    found = e.cast(e("ReduceSum", taken, keepdims=0), INT64)
    count = e("Max", e("Min", found, most), i64(0))
    values = e.flat(e("Where", e("Greater", taken, f32(0)), ranks, f32(-1)))
    rows = e("Max", count, i64(1))
    _, kept = e.top(values, rows, sort=True)
    strength, order = e.top(e("Gather", e.flat(scores), kept), rows, sort=True)
    return strength, e("Gather", kept, order), count
