"""The phases of a gradient put together to one map.

In the blocked layout in which ONNX Runtime convolves, and in NCHW, interleaving moves single values.  Channels last it
moves whole pixels: joining two maps along the channels IS interleaving their columns, once the result is read as twice
as many pixels, and joining rows along the width is interleaving them.  ONNX Runtime changes from blocks to channels
last and back in one go.

requires : known channels.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from elf_export.dialect.emit import squeeze

from .phases import Extent, Phases, all_phases
from .site import Site


def whole(site: Site, part: Phases, output: str) -> None:
    """The gradient as one (N, C, H, W) value, `output`: phases interleaved and cut, or filled up, to `like`."""
    if part.step == 2 and not part.joined:
        full = interleaved(site, part.pieces)
        last = fitted(site, full, part, 1, "whole_nhwc")
        site.op("Transpose", last, role="whole", outputs=[output], perm=[0, 3, 1, 2])
        return
    (piece,) = part.pieces if part.joined else (site.op("Concat", *part.pieces, role="phases", axis=1),)
    full = site.op("DepthToSpace", piece, role="interleaved", blocksize=part.step, mode="DCR")
    fitted(site, full, part, 2, "whole", output)


def mean(site: Site, part: Phases, output: str) -> None:
    """The mean over the channels, (N, H, W), of phases that are side by side in one piece.

    One ConvTranspose adds up the channels and interleaves what is left.
    """
    (piece,), size, channels = part.pieces, [part.step] * 2, site.known_channels
    places = np.repeat(np.eye(part.step**2).reshape(-1, 1, *size), channels, axis=0)
    kernel = site.const(places, "places", like=part.like)
    sums = site.op("ConvTranspose", piece, kernel, role="sums", kernel_shape=size, strides=size)
    found = fitted(site, sums, part, 2, "cut")
    if channels > 1:
        found = site.op("Div", found, site.const(channels, "channels", like=part.like), role="mean")
    squeeze(site, found, [1], "map", outputs=[output])


def interleaved(site: Site, pieces: Sequence[str]) -> str:
    """Phases 00, 01, 10, 11, (N, C, h, w) each, to one map channels last, (N, 2 h, 2 w, C)."""
    last = [
        channels_last(site, piece, "phase_{}{}_nhwc".format(*at))
        for at, piece in zip(all_phases(2), pieces, strict=True)
    ]
    return rows(site, (columns(site, last[:2], "even"), columns(site, last[2:], "odd")), "interleaved")


def columns(site: Site, pair: Sequence[str], role: str) -> str:
    """Even and odd columns, (N, h, w, C) each, interleaved: (N, h, 2 w, C)."""
    beside = site.op("Concat", *pair, role=f"{role}_pairs", axis=3)
    return site.op("Reshape", beside, site.int64s([0, 0, -1, site.known_channels], f"{role}_shape"), role=role)


def rows(site: Site, pair: Sequence[str], role: str) -> str:
    """Even and odd rows, (N, h, w, C) each, interleaved: (N, 2 h, w, C)."""
    behind = site.op("Concat", *pair, role=f"{role}_stacked", axis=2)
    width = slice_of_shape(site, pair[0], 2, 3, f"{role}_width")
    sizes = [site.int64s([0, -1], f"{role}_keep"), width, site.int64s([site.known_channels], f"{role}_channels")]
    return site.op("Reshape", behind, site.op("Concat", *sizes, role=f"{role}_shape", axis=0), role=role)


def fitted(site: Site, full: str, part: Phases, axis: int, role: str, output: str | None = None) -> str:
    """`full` cut, or filled up with zeros (extent FLOOR), to the H and W of `part.like`, (N, C, H, W).

    `axis` is where H and W begin in `full`: 2, or 1 channels last.
    """
    outputs: int | list[str] = 1 if output is None else [output]
    size = slice_of_shape(site, part.like, 2, 4, f"{role}_size")
    if part.extent is not Extent.FLOOR:
        bounds = [site.int64s(v, f"{role}_{what}") for v, what in (([0, 0], "from"), ([axis, axis + 1], "axes"))]
        return site.op("Slice", full, bounds[0], size, bounds[1], role=role, outputs=outputs)
    # Rows and columns that no window covers are zero.
    have = slice_of_shape(site, full, axis, axis + 2, f"{role}_full_size")
    before, after = (site.int64s([0] * n, f"{role}_{what}") for n, what in ((4 + axis, "before"), (2 - axis, "after")))
    lack = site.op("Sub", size, have, role=f"{role}_lack")
    pads = site.op("Concat", before, lack, *([after] if axis == 1 else []), role=f"{role}_pads", axis=0)
    fill = site.const(0, f"{role}_fill", like=part.like)
    return site.op("Pad", full, pads, fill, role=role, outputs=outputs, mode="constant")


def channels_last(site: Site, value: str, role: str) -> str:
    """(N, C, H, W) -> (N, H, W, C)."""
    return site.op("Transpose", value, role=role, perm=[0, 2, 3, 1])


def channels_first(site: Site, value: str, role: str) -> str:
    """(N, H, W, C) -> (N, C, H, W)."""
    return site.op("Transpose", value, role=role, perm=[0, 3, 1, 2])


def slice_of_shape(site: Site, value: str, start: int, stop: int, role: str) -> str:
    """int64 (stop - start,): sizes of a value along some of its axes."""
    shape = site.op("Shape", value, role=f"{role}_shape")
    bounds = [site.int64s([v], f"{role}_{what}") for v, what in ((start, "from"), (stop, "to"), (0, "axis"))]
    return site.op("Slice", shape, *bounds, role=role)
