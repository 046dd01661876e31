"""Descriptors at keypoints, as `elf_runtime.detection.descriptors` has them."""

from __future__ import annotations

import numpy as np

from elf_runtime import DescriptorSpec

from .emit import DOUBLE, FLOAT, INT64, Emit, f32, f64, i64


def described(e: Emit, values: str, spec: DescriptorSpec, x: str, y: str) -> str:
    """(K, D) float32 of unit length: the map `values`, (1, h, w, D), at working pixels x and y, (K,) float64 each."""
    height, width = e.size(values, 1), e.size(values, 2)
    (x0, x1, fx), (y0, y1, fy) = (_cells(e, at, size, spec) for at, size in ((x, width), (y, height)))
    gx, gy = e("Sub", f32(1), fx), e("Sub", f32(1), fy)
    corners = [e("Add", e("Mul", row, width), column) for row in (y0, y1) for column in (x0, x1)]
    weights = [e("Mul", a, b) for b in (gy, fy) for a in (gx, fx)]
    index = e("Concat", *map(e.column, corners), axis=1)
    mixed = e("Unsqueeze", e("Concat", *map(e.column, weights), axis=1), np.array([1], i64))
    rows = e("Gather", e("Reshape", values, np.array([-1, spec.dim], i64)), index)  # (K, 4, D)
    found = e("Squeeze", e("MatMul", mixed, rows), np.array([1], i64))
    squares = e("ReduceSum", e("Mul", found, found), np.array([1], i64), keepdims=1)
    return e("Div", found, e("Max", e("Sqrt", squares), f32(np.finfo(f32).tiny)))


def _cells(e: Emit, at: str, size: str, spec: DescriptorSpec) -> tuple[str, str, str]:
    """The cells on both sides of places along an axis, int64, and how far towards the second, float32."""
    last = e("Sub", size, i64(1))
    cell = e("Div", e("Sub", at, f64(spec.offset)), f64(spec.stride))
    cell = e("Min", e("Max", cell, f64(0)), e.cast(last, DOUBLE))
    low = e("Min", e.cast(cell, INT64), e("Max", e("Sub", size, i64(2)), i64(0)))
    return low, e("Min", e("Add", low, i64(1)), last), e.cast(e("Sub", cell, e.cast(low, DOUBLE)), FLOAT)
