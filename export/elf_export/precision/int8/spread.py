"""A strided convolution's adjoint as 8-bit convolutions: one for each phase of the result, and interleaving.

With stride s, full[s m + a] = sum over u of W[s u + a + p] dy[m - u], p being the padding in front: every phase a of
the result is a convolution of stride 1 with every s-th row and column of the kernel.  Channels last, the phases side by
side along the channels are interleaved by moving whole pixels.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import onnx

from elf_export.adjoint import interleave
from elf_export.graph.graph import Array, attributes

from .candidates import only_reader
from .convolve import BREADTH, convolve, magnitude_of_two, two_steps_of
from .quantizer import Quantizer
from .scheme import Scheme

Phase = tuple[int, int]


def spread(quantizer: Quantizer, node: onnx.NodeProto) -> None:
    """Append what takes the place of a ConvTranspose whose input is rounded."""
    y, scheme = node.output[0], quantizer.schemes[node.output[0]]
    given = attributes(node)
    kernel = quantizer.source.constant(node.input[1])
    assert kernel is not None, "checked by is_spreading"
    stride, group = given["strides"][0], given.get("group", 1)
    if group == 1:
        kernel = kernel.swapaxes(0, 1)
    count = len(kernel)
    magnitude = group == 1 and _is_magnitude(quantizer, y)
    if magnitude:
        kernel = two_steps_of(kernel, max(1, BREADTH // stride**2))
    phases = [(a, b) for a in range(stride) for b in range(stride)]
    # Few channels: all phases by one convolution.
    together = group == 1 and len(kernel) < BREADTH
    begin = given.get("pads", [0, 0])[:2]
    parts = []
    for wanted in [phases] if together else [[phase] for phase in phases]:
        name = all_phases(y) if together else "{}/phase_{}{}".format(y, *wanted[0])
        parts.append(_convolved(quantizer, node, kernel, stride, begin, wanted, name, scheme))
    q = _interleaved(quantizer, y, parts, stride, len(kernel))
    if not magnitude:
        quantizer.dequantize(y, q, scheme)
        return
    both = f"{y}/both"
    quantizer.dequantize(both, q, scheme)
    magnitude_of_two(quantizer, y, both, count)


def all_phases(y: str) -> str:
    """Name of the phases of y that one convolution makes."""
    return f"{y}/phases"


def _is_magnitude(quantizer: Quantizer, y: str) -> bool:
    """Whether the part that is read of y goes to an Abs, and nowhere else."""
    part = only_reader(quantizer.readers, y)
    after = only_reader(quantizer.readers, part.output[0]) if part is not None else None
    return after is not None and after.op_type == "Abs"


def _convolved(
    quantizer: Quantizer, node: onnx.NodeProto, kernel: Array, stride: int, begin: Sequence[int],
    wanted: Sequence[Phase], name: str, scheme: Scheme,
) -> str:  # fmt: skip
    """The integers of the phases `wanted`, side by side along the channels."""
    taps = [_taps(k, stride, p, [phase[axis] for phase in wanted])
            for axis, (k, p) in enumerate(zip(kernel.shape[2:], begin, strict=True))]  # fmt: skip
    # With 0 among them, no side has less than no padding.
    low = [min([0, *(u for u, _, _ in t)]) for t in taps]
    high = [max([0, *(u for u, _, _ in t)]) for t in taps]
    size = [h - lo + 1 for lo, h in zip(low, high, strict=True)]
    part = np.zeros((len(wanted), *kernel.shape[:2], *size))
    for (uy, ay, jy), (ux, ax, jx) in itertools.product(*taps):
        if (ay, ax) in wanted:
            part[wanted.index((ay, ax)), :, :, high[0] - uy, high[1] - ux] = kernel[:, :, jy, jx]
    # All phases have as many rows, and columns, as the longest one: h + more.
    more = [-(-(k - 1 - p) // stride) for k, p in zip(kernel.shape[2:], begin, strict=True)]
    pads = [*high, *(m - lo for m, lo in zip(more, low, strict=True))]
    conv = onnx.helper.make_node(
        "Conv", node.input[:1], [name], name=name, kernel_shape=size, pads=pads, group=attributes(node).get("group", 1)
    )
    convolve(quantizer, conv, node.input[0], part.reshape(-1, *part.shape[2:]), None, name)
    quantizer.origins[name] = node.output[0]
    quantizer.round(name, scheme)
    return quantizer.integers[name]


def _taps(size: int, stride: int, begin: int, phases: Sequence[int]) -> list[tuple[int, int, int]]:
    """Along one axis: (shift u, phase, row of the kernel) of all rows that reach one of the phases."""
    found = ((j - begin, j) for j in range(size))
    return [(at // stride, at % stride, j) for at, j in found if at % stride in phases]


def _interleaved(quantizer: Quantizer, y: str, parts: list[str], stride: int, channels: int) -> str:
    """(N, C, h, w) for each phase, in raster order, to (N, C, h s, w s)."""
    graph = quantizer.graph
    joined = parts[0] if len(parts) == 1 else graph.op("Concat", *parts, name=f"{y}/phases_q", axis=1)
    last = interleave.channels_last(graph, joined, f"{y}/phases_nhwc")
    apart = graph.op(
        "Reshape", last, graph.int64s([0, 0, 0, stride, stride * channels], f"{y}/apart_shape"), name=f"{y}/apart"
    )
    rows = graph.op("Transpose", apart, name=f"{y}/rows", perm=[0, 1, 3, 2, 4])
    width = interleave.slice_of_shape(graph, last, 2, 3, f"{y}/width")
    wide = graph.op("Mul", width, graph.int64s([stride], f"{y}/stride"), name=f"{y}/wide")
    shape = graph.op(
        "Concat", graph.int64s([0, -1], f"{y}/keep"), wide, graph.int64s([channels], f"{y}/channels"),
        name=f"{y}/whole_shape", axis=0,
    )  # fmt: skip
    whole = graph.op("Reshape", rows, shape, name=f"{y}/whole")
    return interleave.channels_first(graph, whole, f"{y}/whole_q")
