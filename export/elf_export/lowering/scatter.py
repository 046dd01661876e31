"""Windows taken apart into views of a map, one for each place in a window, and put together again.

requires : a map of floats, of any number of spatial axes.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from elf_export.dialect.emit import FAR, concat_ints, slice_axes
from elf_export.dialect.spatial import begin_pads, crop_spatial, pad_spatial, spatial_shape
from elf_export.graph.windows import Window

from .site import Site

Offset = tuple[int, ...]


def offsets_of(window: Window) -> list[Offset]:
    """Offsets of a window's places from its start, in pixels, in raster order."""
    ranges = (range(0, k * d, d) for k, d in zip(window.kernel, window.dilations, strict=True))
    return list(itertools.product(*ranges))


def tag(offset: Offset) -> str:
    return "".join(f"_{o}" for o in offset)


def views_of(site: Site, x: str, y: str, window: Window, offsets: Sequence[Offset]) -> dict[Offset, str]:
    """x_o[m] = padded x at m s + o, of y's size: one strided Slice per offset."""
    if window.padded:
        lowest = float(np.finfo(site.dtype(x)).min)
        extra = [e + (s - 1 if window.ceil else 0) for e, s in zip(window.end, window.strides, strict=True)]
        x = pad_spatial(site, x, x, begin_pads(site, window, x), extra, "padded", fill=lowest)
    steps = site.int64s(window.strides, "view_steps")
    span = site.op("Mul", spatial_shape(site, y, "y_size"), steps, role="span")
    axes = site.int64s(window.spatial_axes, "view_axes")
    views = {}
    for offset in offsets:
        start = site.int64s(offset, f"view_start{tag(offset)}")
        end = site.op("Add", span, start, role=f"view_end{tag(offset)}")
        views[offset] = site.op("Slice", x, start, end, axes, steps, role=f"view{tag(offset)}")
    return views


def scatter(site: Site, x: str, pieces: Mapping[Offset, str], window: Window) -> str:
    """dx of x's shape with dx[m s + o] = sum of pieces[o][m] over all (m, o) that meet there.

    An offset is q strides and a rest r.  All pieces with the same rest land on the same phase of dx, shifted
    by q; the phases are then interleaved, and what lies outside x is cut or what is missing is zero.
    """
    n, strides = len(window.kernel), window.strides
    most = tuple((e - 1) // s for e, s in zip(window.extent, strides, strict=True))
    by_phase: dict[Offset, list[str]] = {}
    for offset, piece in pieces.items():
        shift = tuple(o // s for o, s in zip(offset, strides, strict=True))
        phase = tuple(o % s for o, s in zip(offset, strides, strict=True))
        if any(most):
            after = [m - q for m, q in zip(most, shift, strict=True)]
            piece = pad_spatial(site, piece, x, shift, after, f"shifted{tag(offset)}")
        by_phase.setdefault(phase, []).append(piece)
    phases = []
    for phase in itertools.product(*(range(s) for s in strides)):
        parts = by_phase.get(phase)
        if parts is None:  # a stride beyond the window leaves gaps
            some = next(iter(by_phase.values()))[0]
            zero = site.const(0, f"nothing{tag(phase)}", like=x)
            parts = [site.op("Mul", some, zero, role=f"gap_phase{tag(phase)}")]
        phases.append(parts[0] if len(parts) == 1 else site.op("Sum", *parts, role=f"phase{tag(phase)}"))
    full = _interleave(site, phases, strides)

    dims = (site.shape(x) or [])[2:]
    if not window.padded and window.extent == strides:
        if all(isinstance(d, int) and d % s == 0 for d, s in zip(dims, strides, strict=True)):
            return full
        # Floor mode drops up to s - 1 trailing pixels; their gradient is zero.
        size = spatial_shape(site, x, "x_size")
        lack = site.op("Sub", size, spatial_shape(site, full, "full_size"), role="lack")
        return pad_spatial(site, full, x, [0] * n, lack, "dx")
    begin = begin_pads(site, window, x)
    if any(s > 1 for s in strides):
        full = pad_spatial(site, full, x, [0] * n, [s - 1 for s in strides], "room")
    return crop_spatial(site, full, begin, spatial_shape(site, x, "x_size"), "dx", window.spatial_axes)


def _interleave(site: Site, phases: Sequence[str], strides: Sequence[int]) -> str:
    """(N, C, h...) per phase, in raster order -> (N, C, h s...)."""
    if len(phases) == 1:
        return phases[0]
    joined = site.op("Concat", *phases, role="phases", axis=1)
    n = len(strides)
    if n == 2 and strides[0] == strides[1]:
        return site.op("DepthToSpace", joined, role="interleaved", blocksize=strides[0], mode="DCR")
    # (N, s1..sn, C, h1..hn) -> (N, C, h1, s1, ..., hn, sn) -> (N, C, h1 s1, ..., hn sn)
    size = slice_axes(site, site.op("Shape", phases[0], role="phase_shape"), [2], [FAR], [0], "phase_size")
    apart = site.op("Reshape", joined, concat_ints(site, [[0, *strides, -1], size], "split_shape"), role="split")
    order = [0, n + 1, *itertools.chain.from_iterable((n + 2 + i, 1 + i) for i in range(n))]
    turned = site.op("Transpose", apart, role="turned", perm=order)
    merged = site.op("Mul", size, site.int64s(strides, "merge_strides"), role="merged_size")
    return site.op("Reshape", turned, concat_ints(site, [[0, 0], merged], "merge_shape"), role="interleaved")
