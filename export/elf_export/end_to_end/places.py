"""Where keypoints may be, as `elf_runtime.image.masks`, `detection.contrast` and `detection.scaling` have it."""

from __future__ import annotations

import numpy as np

from elf_runtime import DetectionParams
from elf_runtime.detection.contrast import LEAST_WINDOW

from .emit import DOUBLE, FLOAT, INT64, Emit, f32, f64, i64
from .levels import mirrored, separable
from .resize import Working


def mask_border(e: Emit, params: DetectionParams, receptive_field: float, scale: str) -> str:
    """Source pixels, int64 (), that keypoints keep away from a mask's edge: see `DetectionParams.mask_border`."""
    if not isinstance(params.mask_border, str):
        return e.value(i64(params.mask_border))
    if not receptive_field:
        return e.value(i64(params.border))
    reach = f64((receptive_field - 1 + params.denoise[0] - 1) / 2)
    return e.cast(e("Ceil", e("Div", reach, scale)), INT64)


def shrunk(e: Emit, mask: str, pixels: str) -> str:
    """A mask, (H', W') of numbers, as bools without the pixels that lie so near to one that it leaves out.

    A pixel stays if the window around it has no pixel left out: the running sum grows by nothing across it.
    """
    left_out = e.cast(e("Equal", e.cast(mask, FLOAT), f32(0)), DOUBLE)
    for axis in (0, 1):
        n = e.size(mask, axis)
        total = e("Pad", e("CumSum", left_out, i64(axis)), np.eye(4, dtype=i64)[axis])  # a line of zeros in front
        end = e("Min", e("Add", e("Add", e.count(n), pixels), i64(1)), n)
        begin = e("Max", e("Sub", e.count(n), pixels), i64(0))
        left_out = e("Sub", e("Gather", total, end, axis=axis), e("Gather", total, begin, axis=axis))
    return e("Equal", left_out, f64(0))


def looked_up(e: Emit, mask: str, x: str, y: str, working: Working) -> str:
    """The mask at the source pixels that working pixels (x, y), float64 of shapes that broadcast, lie in: bools.

    A mask of 1 x 1 stands for the whole image.
    """
    places = []
    for axis, at in ((0, y), (1, x)):
        pixel = e.cast(e("Round", working.to_source(e, at, axis)), INT64)
        last = e("Sub", e("Min", e.size(mask, axis), working.source[axis]), i64(1))
        places.append(e("Min", e("Max", pixel, i64(0)), last))
    flat = e("Add", e("Mul", places[0], e.size(mask, 1)), places[1])
    return e("Gather", e.flat(mask), flat)


def allowed_pixels(e: Emit, mask: str, working: Working) -> str:
    """(h, w) bool: where the mask has the source pixel of a working pixel's centre."""
    rows, columns = (e.cast(e.count(size), DOUBLE) for size in working.working)
    return looked_up(e, mask, e("Unsqueeze", columns, np.array([0], i64)), e.column(rows), working)


def within_border(e: Emit, border: int, working: Working) -> str:
    """(h, w) bool: working pixels whose centres lie at least `border` source pixels inside; see `Scaling.margin`.

    (2 m + 1) size - working lies between 2 border working and 2 (size - 1 - border) working, in integers.
    """
    inside = []
    for axis in (0, 1):
        size, n = working.source[axis], working.working[axis]
        at = e("Sub", e("Mul", e("Add", e("Mul", e.count(n), i64(2)), i64(1)), size), n)
        most = e("Mul", e("Mul", e("Sub", size, i64(1 + border)), i64(2)), n)
        inside.append(e("And", e("Not", e("Less", at, e("Mul", n, i64(2 * border)))), e("Not", e("Greater", at, most))))
    return e("And", e.column(inside[0]), e("Unsqueeze", inside[1], np.array([0], i64)))


def textured(e: Emit, pixels: str) -> str:
    """bool (): whether the pixels, (1, H, W, C) of the image, have more than one colour."""
    most, least = (e(op, pixels, axes=[1, 2], keepdims=0) for op in ("ReduceMax", "ReduceMin"))
    return e("Greater", e("ReduceMax", e("Sub", most, least), keepdims=0), f32(0))


def contrast_window(receptive_field: float) -> int:
    """The side of the contrast's window, odd, for images of any size: see `contrast.window_for`."""
    side = max(LEAST_WINDOW, int(receptive_field))
    return max(3, side - 1 | 1)


def enough_contrast(e: Emit, pixels: str, channels: int, side: int, least: float) -> str:
    """(h, w) bool: `contrast.contrast_map` of (1, h, w, C) pixels is at least `least`."""
    x = e("Transpose", pixels, perm=[0, 3, 1, 2])
    centred = e("Sub", x, e("ReduceMean", x, keepdims=1))
    r = side // 2
    ones, ramp = np.ones(side) / side, np.arange(-r, r + 1) / side
    slope = ramp * np.sqrt(3 / (r * (r + 1)))
    # Of each channel the means of g, y g and x g, so scaled that their squares are what a plane explains.
    means = mirrored(e, centred, r)
    for kernels, shape in (((ones, slope), (1, 1, -1)), ((ones, slope, ones, 0 * ones), (1, -1, 1))):
        filters = np.stack([kernel.reshape(shape) for kernel in kernels * channels]).astype(f32)
        means = e("Conv", means, filters, group=channels * len(kernels) // 2)
    explained = e("Mul", e("ReduceSumSquare", means, axes=[1], keepdims=1), f32(1 / channels))
    square = separable(e, e("ReduceMean", e("Mul", centred, centred), axes=[1], keepdims=1), ones, ones)
    enough = e("Not", e("Less", e("Sub", square, explained), f32(least * least)))
    return e("Squeeze", enough, np.array([0, 1], i64))
