"""The image at the working size, as `elf_runtime.detection.working_image` and `image.convert.resized` make it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elf_runtime import InputSpec

from .emit import DOUBLE, FLOAT, INT64, Emit, f32, f64, i64


@dataclass(frozen=True)
class Working:
    """Names of values.

    Attributes
    ----------
    pixels : (N, h, w, C) float32
        As the network takes them.
    source, working : (int64 (), int64 ())
        Height and width of the image, and of what the network sees.
    scale : float64 ()
        Above the one that is asked for where the image is small.
    """

    pixels: str
    source: tuple[str, str]
    working: tuple[str, str]
    scale: str

    def ratio(self, e: Emit, axis: int) -> str:
        """float64 (): working pixels for one of the source along an axis, 0 being y."""
        return e("Div", e.cast(self.working[axis], DOUBLE), e.cast(self.source[axis], DOUBLE))

    def to_source(self, e: Emit, places: str, axis: int) -> str:
        """Working pixels to source pixels along an axis, float64: (p + 1/2) / ratio - 1/2."""
        return e("Sub", e("Div", e("Add", places, f64(0.5)), self.ratio(e, axis)), f64(0.5))


def working_image(e: Emit, image: str, spec: InputSpec, scale: float, color: str = "bgr") -> Working:
    """From (N, H, W, 1 or 3) of any number type to float32 pixels at the working scale, in `spec`'s channels.

    `color` is the order of the image's, "bgr" or "rgb".
    """
    source = (e.size(image, 1), e.size(image, 2))
    pixels = e.cast(image, FLOAT)
    working, wanted = source, e.value(f64(scale))
    if scale != 1.0 or spec.multiple > 1:
        if scale < 1.0:  # a small image is seen at a larger scale
            smallest = e.cast(e("Min", *source), DOUBLE)
            wanted = e("Max", wanted, e("Div", f64(spec.min_size), smallest))
        working = (_allowed(e, source[0], wanted, spec), _allowed(e, source[1], wanted, spec))
        pixels = _resampled(e, pixels, source, working, linear=scale > 1.0)
    return Working(_channels(e, pixels, spec, color), source, working, wanted)


def _allowed(e: Emit, size: str, scale: str, spec: InputSpec) -> str:
    """`InputSpec.size_for` along an axis."""
    real = e("Mul", e.cast(size, DOUBLE), scale)
    if spec.multiple == 1:
        return e.cast(e("Max", e("Round", real), f64(1)), INT64)
    least = f64(-(-spec.min_size // spec.multiple))
    steps = e("Max", e("Round", e("Div", real, f64(spec.multiple))), least)
    return e.cast(e("Mul", steps, f64(spec.multiple)), INT64)


def _resampled(e: Emit, pixels: str, source: tuple[str, str], working: tuple[str, str], linear: bool) -> str:
    """(N, H, W, C) -> (N, h, w, C), columns first as OpenCV: each is a weighted sum of the few that it covers.

    ONNX Runtime is fast where a transposition moves one axis to the end or from there.
    """
    batch, channels = e.size(pixels, 0), e.size(pixels, 3)
    # (N, H, W * C) -> (W * C, N, H) -> (w, C * N * H)
    lines = e("Transpose", e("Reshape", pixels, _shape(e, batch, source[0], i64(-1))), perm=[2, 0, 1])
    columns = _mixed(e, lines, source[1], working[1], linear)
    # (w * C * N, H) -> (H, w * C * N) -> (h, w * C * N)
    lines = e("Transpose", e("Reshape", columns, _shape(e, i64(-1), source[0])), perm=[1, 0])
    mixed = e("Reshape", _mixed(e, lines, source[0], working[0], linear), _shape(e, i64(-1), batch))
    # (h * w * C, N) -> (N, h * w * C)
    return e("Reshape", e("Transpose", mixed, perm=[1, 0]), _shape(e, batch, *working, channels))


def _mixed(e: Emit, lines: str, n: str, m: str, linear: bool) -> str:
    """(n, ...) -> (m, P): the weighted sums of lines."""
    index, weights = (_linear if linear else _area)(e, n, m)
    taken = e("Gather", e("Reshape", lines, _shape(e, n, i64(-1))), index, axis=0)
    return e("Squeeze", e("MatMul", e("Unsqueeze", weights, np.array([1], i64)), taken), np.array([1], i64))


def _shape(e: Emit, *sizes: str | np.int64) -> str:
    return e("Concat", *(e("Reshape", size, np.array([1], i64)) for size in sizes), axis=0)


def _area(e: Emit, n: str, m: str) -> tuple[str, str]:
    """Places (m, K) int64 and weights (m, K) float32 of an area average from n to m <= n pixels.

    Output i covers [i s, (i + 1) s) with s = n / m; input j in it counts by the length of what they share, over s.
    """
    s = e("Div", e.cast(n, DOUBLE), e.cast(m, DOUBLE))
    taps = e.count(e("Add", e.cast(e("Ceil", s), INT64), i64(1)))
    begin = e.column(e("Mul", e.cast(e.count(m), DOUBLE), s))
    end = e("Add", begin, s)
    place = e("Add", e.cast(e("Floor", begin), INT64), taps)
    left = e.cast(place, DOUBLE)
    shared = e("Sub", e("Min", end, e("Add", left, f64(1))), e("Max", begin, left))
    return _clipped(e, place, n), e.cast(e("Div", e("Max", shared, f64(0)), s), FLOAT)


def _linear(e: Emit, n: str, m: str) -> tuple[str, str]:
    """Places (m, 2) and weights (m, 2) of a linear interpolation from n to m >= n pixels, as of OpenCV's resize."""
    s = e("Div", e.cast(n, DOUBLE), e.cast(m, DOUBLE))
    at = e("Sub", e("Mul", e("Add", e.cast(e.count(m), DOUBLE), f64(0.5)), s), f64(0.5))
    last = e.cast(e("Sub", n, i64(1)), DOUBLE)
    at = e("Min", e("Max", at, f64(0)), last)
    low = e("Floor", at)
    high = e.column(e.cast(e("Sub", at, low), FLOAT))
    place = e("Add", e.column(e.cast(low, INT64)), np.array([0, 1], i64))
    return _clipped(e, place, n), e("Concat", e("Sub", f32(1), high), high, axis=1)


def _clipped(e: Emit, place: str, n: str) -> str:
    return e("Min", place, e("Sub", n, i64(1)))


_GRAY = (0.114, 0.587, 0.299)  # of blue, green and red


def _channels(e: Emit, pixels: str, spec: InputSpec, color: str) -> str:
    """1 or 3 channels, of the order `color`, to the network's: grey repeated, or colours mixed, as OpenCV does."""
    given = e("Reshape", e.size(pixels, 3), np.array([1], i64))
    if spec.channels == 3:
        order = [0, 1, 2] if spec.color == color else [2, 1, 0]
        return e("Gather", pixels, e("Min", np.array(order, i64), e("Sub", given, i64(1))), axis=3)
    # Rows 0 to 2 of the table are for three channels, row 3 for one.
    weights = _GRAY if color == "bgr" else _GRAY[::-1]
    table = np.array([[w] for w in (*weights, 1.0)], f32)
    start = e("Where", e("Equal", given, np.array([1], i64)), np.array([3], i64), np.array([0], i64))
    return e("MatMul", pixels, e("Slice", table, start, e("Add", start, given), np.array([0], i64)))
