"""Every operation in portable standard ones, with nothing clever: the readable reference, for any runtime.

requires : the operations of `dialect`, in a graph of any opset from 11 on.
call : by `Lowering`, for a target that has no form of its own; its parts by others.
ensures : the values of `dialect.reference`; standard operations, and Step.
"""

from __future__ import annotations

from elf_export.dialect.emit import step
from elf_export.dialect.spatial import begin_pads, crop_spatial, spatial_shape
from elf_export.graph.windows import Window, window_of

from .scatter import offsets_of, scatter, tag, views_of
from .site import Site


def max_pool_grad(site: Site) -> str:
    """The gradient of each window is handed from one place to the next, in raster order, until somebody takes it:

        r_0 = dy;   taken_o = r_o [x_o = y],   r_{o+1} = r_o - taken_o = r_o [y - x_o > 0]

    The steps are exactly 0 or 1, so nothing is rounded.  Indices (MaxPool's second output and MaxUnpool) are not
    portable, and wrong for windows that overlap.
    """
    rest, y, x = site.node.input
    window = window_of(site.graph, site.node, site.attrs["kernel_shape"])
    offsets = offsets_of(window)
    views, pieces = views_of(site, x, y, window, offsets[:-1]), []
    for offset in offsets[:-1]:
        below = step(site, site.op("Sub", y, views[offset], role=f"gap{tag(offset)}"), f"below{tag(offset)}")
        passed = site.op("Mul", rest, below, role=f"passed{tag(offset)}")
        pieces.append(site.op("Sub", rest, passed, role=f"taken{tag(offset)}"))
        rest = passed
    pieces.append(rest)  # whoever is last takes what nobody took
    return scatter(site, x, dict(zip(offsets, pieces, strict=True)), window)


def window_sum(site: Site) -> str:
    """dy, scaled, at every place of its window."""
    dy, scale, x = site.node.input
    window = window_of(site.graph, site.node, site.attrs["kernel_shape"])
    if scale:
        dy = site.op("Mul", dy, scale, role="share")
    return scatter(site, x, dict.fromkeys(offsets_of(window), dy), window)


def conv_grad(site: Site) -> str:
    """ConvTranspose, whose kernel layout (C_in = O, C_out/g = I/g) is W's own.

    Up to s - 1 trailing pixels were never covered by a window: output_padding makes room for them, and what is beyond x
    is cut.
    """
    dy, weight, x = site.node.input
    window, n = conv_window(site), len(site.shape(weight) or []) - 2
    # Padding in front that is static is cut by ConvTranspose itself, otherwise by the Slice.
    pads = [*(window.begin or (0,) * n), *(0,) * n]
    full = site.op(
        "ConvTranspose", dy, weight, role="dx_full",
        kernel_shape=list(window.kernel), strides=list(window.strides), dilations=list(window.dilations),
        group=site.attrs.get("group", 1), pads=pads, output_padding=[s - 1 for s in window.strides],
    )  # fmt: skip
    start = site.int64s([0] * n, "dx_start") if window.begin is not None else begin_pads(site, window, x)
    return crop_spatial(site, full, start, spatial_shape(site, x, "x_size"), "dx", window.spatial_axes)


def conv_window(site: Site) -> Window:
    """The window of a convolution whose kernel has a static shape."""
    kernel = [d for d in site.shape(site.node.input[1]) or [] if isinstance(d, int)]
    return window_of(site.graph, site.node, kernel[2:])


def between(site: Site) -> str:
    """[low < y < high] = [(y - low) (high - y) > 0]."""
    _, high, y = site.node.input
    below = site.op("Sub", high, y, role="below_high") if high else ""
    return step(site, room(site, below), "inside")


def room(site: Site, below: str) -> str:
    """(y - low) (high - y) of a Between, `below` being the second factor, or empty; positive just inside."""
    low, _, y = site.node.input
    value = site.value(low) if low else None
    starts_at_zero = value is not None and not value.any()
    above = "" if not low else y if starts_at_zero else site.op("Sub", y, low, role="above_low")
    return site.op("Mul", above, below, role="room") if above and below else above or below
