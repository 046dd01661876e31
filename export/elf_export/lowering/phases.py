"""Gradients held as their phases: what passes through convolutions and masks in parts, and is put together late.

The phases of a map v, of step d, are

    v_ab[i, j] = v[d i + a, d j + b],   0 <= a, b < d

The gradients of a 2x2 max-pool and of a strided convolution are made phase by phase, and putting the phases together
moves every value, outside the blocked layout in which ONNX Runtime convolves.  A convolution's gradient can read them
as they are: the same multiplications, sorted by phase.

requires : two spatial axes; known channels; of `convolve` that `can_convolve` says so.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from elf_export.dialect.spatial import transposed
from elf_export.graph.graph import Array
from elf_export.graph.windows import Window

from . import depthwise
from .site import Site

Phase = tuple[int, int]  # its row a and column b
Tap = tuple[int, int, int]  # along one axis: shift u, phase a of dx, tap t
Shared = dict[tuple[tuple[int, ...], bytes], str]  # shape and values of a constant -> its name


class Extent(Enum):
    """How many rows the phases of a map of H rows have, and columns likewise; d is the step."""

    FLOOR = "H // d"  # as floor-mode pooling leaves them: what it drops is zero and not held
    CEIL = "(H + d - 1) // d"
    BEYOND = "up to one more than CEIL"


@dataclass(frozen=True)
class Phases:
    """A gradient v of the shape of the forward value `like`, (N, C, H, W).

    Attributes
    ----------
    pieces : one value for each phase, (N, C, h, w), in raster order; or one with all of them along the channels
    step : int
        Places from one value of a phase to the next.  Of step 1 there is one phase, v itself.
    extent : Extent
        Of h and w.  What is only put together and cut may be of CEIL along one axis; it is then said to be of BEYOND.
    clean : bool
        Whether what the pieces hold beyond H and W is zero.
    """

    pieces: tuple[str, ...]
    like: str
    step: int = 2
    extent: Extent = Extent.FLOOR
    clean: bool = True

    @property
    def joined(self) -> bool:
        """Whether all phases are in one piece, side by side."""
        return len(self.pieces) < self.step**2


def all_phases(step: int) -> list[Phase]:
    return [(a, b) for a in range(step) for b in range(step)]


# -- convolutions ----------------------------------------------------------------------------------------------------


def can_convolve(window: Window, weight: Array | None, group: int) -> bool:
    """Whether `convolve` takes this gradient: constant weights, one stride, no dilation; dense or depthwise."""
    if weight is None or weight.ndim != 4 or window.begin is None or window.dilations != (1, 1):
        return False
    fits = all(pad < k for k, pad in zip(window.kernel * 2, window.begin + window.end, strict=True))
    return fits and len(set(window.strides)) == 1 and (group == 1 or weight.shape[:2] == (group, 1))


def overhang(window: Window) -> list[int]:
    """Along each axis: the image's rows that a single window sees: k - p - q."""
    assert window.begin is not None, "checked by can_convolve"
    return [k - p - q for k, p, q in zip(window.kernel, window.begin, window.end, strict=True)]


def extent_of(window: Window) -> Extent | None:
    """What the phases of a strided convolution's gradient hold; None if that differs between rows and columns."""
    odd = {(over - 1) % window.strides[0] == 0 for over in overhang(window)}
    return None if len(odd) > 1 else Extent.CEIL if odd == {True} else Extent.BEYOND


def convolve(site: Site, dy: Phases, weight: Array, window: Window, group: int, together: bool) -> Phases:
    """dx of a convolution of stride s in phases of step s d, dy being in phases of step d.

    Between phase c of dy and phase a of dx lie the taps  t = a + p - s c - s d u  of the kernel, u being how far the
    one is shifted against the other:  dx_a[j] = sum over c and u of W_t^T dy_c[j + u].

    weight: (O, I/g, k, k);  `together`: all phases of dx by one convolution, of one group, which pays for few channels.
    """
    wanted: list[list[Phase]] = [[phase] for phase in all_phases(window.strides[0] * dy.step)]
    if together and group == 1:
        wanted = [[phase for (phase,) in wanted]]
    kernel, shared = transposed(weight, group), Shared()
    pieces = [_convolved(site, dy, kernel, window, group, phases, shared) for phases in wanted]
    extent = extent_of(window) or Extent.BEYOND
    if window.strides[0] == 1:
        extent = Extent.BEYOND if dy.extent is Extent.FLOOR else dy.extent
    return Phases(tuple(pieces), site.like, window.strides[0] * dy.step, extent, clean=False)


def _convolved(
    site: Site, dy: Phases, kernel: Array, window: Window, group: int, wanted: Sequence[Phase], shared: Shared
) -> str:
    """The phases `wanted` of dx, side by side along the channels; `shared` are the constants there are already."""
    # h windows belong to x of s (h - 1) + k - p - q rows, or up to s - 1 more, which none reaches: so many beyond h.
    beyond = [-((1 - over) // s) for over, s in zip(overhang(window), window.strides, strict=True)]
    more = [rows + (dy.extent is Extent.FLOOR) for rows in beyond]
    tag = "{}{}".format(*wanted[0]) if len(wanted) == 1 else "all"
    reading = [
        (source, piece, [_taps(window, axis, dy.step, source[axis], {p[axis] for p in wanted}) for axis in (0, 1)])
        for source, piece in zip(all_phases(dy.step), dy.pieces, strict=True)
    ]
    total: str | None = None
    # A phase that no tap reaches is zero.
    for (c, d), piece, taps in [read for read in reading if all(read[2])] or reading[:1]:
        part, pads = _kernel(kernel, taps, wanted, more)
        key = part.shape, part.tobytes()  # the taps on even or odd rows and columns are the same for every phase of dx
        role = f"{tag}_from_{c}{d}" if dy.step > 1 else tag
        if key not in shared:
            shared[key] = site.const(part, f"weight_{role}")
        size = list(part.shape[2:])
        term = site.op("Conv", piece, shared[key], role=f"dx_{role}", kernel_shape=size, pads=pads, group=group)
        # A sum of two, the convolution first, is computed in place by it.
        total = term if total is None else site.op("Add", term, total, role=f"dx_{tag}_with_{c}{d}")
    assert total is not None
    return total


def _kernel(
    kernel: Array, taps: Sequence[Sequence[Tap]], wanted: Sequence[Phase], more: Sequence[int]
) -> tuple[Array, list[int]]:
    """The taps as one kernel, (phases I, O/g, rows, columns), and its pads: as many rows as dy's and `more`."""
    shifts = [[u for u, _, _ in t] or [0] for t in taps]
    # No side has less than no padding.
    low = [min(0, *u) for u in shifts]
    high = [max(*u, -m) for u, m in zip(shifts, more, strict=True)]
    count, channels = kernel.shape[:2]
    part = np.zeros(
        (len(wanted) * count, channels, *(h - lo + 1 for lo, h in zip(low, high, strict=True))), kernel.dtype
    )
    for (uy, ay, ty), (ux, ax, tx) in itertools.product(*taps):
        if (ay, ax) in wanted:
            at = wanted.index((ay, ax)) * count
            part[at : at + count, :, uy - low[0], ux - low[1]] = kernel[:, :, ty, tx]
    return part, [-lo for lo in low] + [h + m for h, m in zip(high, more, strict=True)]


def _taps(window: Window, axis: int, step: int, source: int, wanted: set[int]) -> list[Tap]:
    """Along one axis: the taps by which the phases of dx read phase `source` of dy."""
    assert window.begin is not None, "checked by can_convolve"
    size, pad, stride = window.kernel[axis], window.begin[axis], window.strides[axis]
    reads = [(a + pad - stride * source - t, a, t) for a in sorted(wanted) for t in range(size)]
    return [(at // (stride * step), a, t) for at, a, t in reads if at % (stride * step) == 0]


# -- masks ---------------------------------------------------------------------------------------------------------


def masked(site: Site, dy: Phases, v: str) -> Phases:
    """dy [v > 0], phase by phase; of four phases.  v is of the shape of `site.like`."""
    pieces = []
    for (a, b), piece in zip(all_phases(2), dy.pieces, strict=True):
        (rows, above, below), (columns, left, right) = (every_second(c, dy.extent) for c in (a, b))
        pads, pick = (above, left, below, right), np.outer(rows, columns)
        mask = depthwise.step(site, v, pick, [2, 2], f"mask_{a}{b}", pads, dilations=[2, 2])
        pieces.append(site.op("Mul", piece, mask, role=f"dx_{a}{b}"))
    # Beyond v's edge the masks are zero, and with them the products.
    return Phases(tuple(pieces), site.like, extent=dy.extent)


def every_second(phase: int, extent: Extent) -> tuple[list[int], int, int]:
    """Along one axis: the taps, 2 places apart, and the zeros before and behind that give phase 0 or 1 every 2 places.

    Of the places in between none is read: they are half of a map that has long left the caches.
    """
    if phase:
        # Places 2 i - 1 and 2 i + 1, of which the second counts.
        return [0, 1], 1, {Extent.FLOOR: 0, Extent.CEIL: 1, Extent.BEYOND: 2}[extent]
    # The last place of an odd number of them is left out by a tap behind it.
    return ([1, 0], 0, 1) if extent is Extent.FLOOR else ([1], 0, int(extent is Extent.BEYOND))
