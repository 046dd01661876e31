"""Exact greedy non-maximum suppression, and the strongest that it leaves, as `elf_runtime.detection.nms` has them."""

from __future__ import annotations

import numpy as np
from onnx import TensorProto, helper

from .emit import BOOL, FLOAT, INT64, Emit, f32, i64

_MOST_ROUNDS = 1_000_000  # of the Loop: it ends when no candidate is left


def dilated(e: Emit, x: str, radius: int) -> str:
    """The largest of the square window of 2 radius + 1 pixels around each; (1, 1, h, w)."""
    side = 2 * radius + 1
    x = e("MaxPool", x, kernel_shape=[1, side], pads=[0, radius, 0, radius])
    return e("MaxPool", x, kernel_shape=[side, 1], pads=[radius, 0, radius, 0])


def window_maxima(e: Emit, scores: str, radius: int) -> str:
    """(1, 1, h, w) bool: scores that no other exceeds in their window, whether these passed or not."""
    return e("Not", e("Less", scores, dilated(e, scores, radius)))


def greedy(e: Emit, scores: str, candidates: str, radius: int, rounds: int) -> str:
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
    n = e.cast(count, INT64)
    masked = e.flat(e("Where", candidates, scores, f32(-1)))
    _, order = e.top(masked, n, sort=True)  # equal ones by ascending place
    numbers = e("Sub", count, e.cast(e.count(n), FLOAT))
    ranks = e("ScatterElements", e("Mul", masked, f32(0)), order, numbers, axis=0)
    left = e("Reshape", ranks, e("Shape", scores))
    taken = e("Mul", left, f32(0))
    if rounds == 0:
        return _loop(e, left, taken, radius)
    for _ in range(rounds):
        left, taken = _round(e, left, taken, radius)
    return taken


def _round(e: Emit, left: str, taken: str, radius: int) -> tuple[str, str]:
    first = e.cast(e.both(e("Equal", left, dilated(e, left, radius)), e("Greater", left, f32(0))), FLOAT)
    covered = e("Greater", dilated(e, first, radius), f32(0))
    return e("Where", covered, f32(0), left), e("Max", taken, first)


def _loop(e: Emit, left: str, taken: str, radius: int) -> str:
    """The rounds as an ONNX Loop, whose body is moved out of the graph's end, where it is written like any other."""
    graph = e.graph
    start = len(graph.nodes)
    inner, before = (graph.unique(f"post/suppress/{name}") for name in ("left", "taken"))
    rest, after = _round(e, inner, before, radius)
    more = e("Greater", e("ReduceMax", rest, keepdims=0), f32(0))
    nodes = list(graph.nodes[start:])
    copies = [type(node).FromString(node.SerializeToString()) for node in nodes]
    for node in reversed(nodes):
        graph.remove(node)
    shape = [1, 1, "h", "w"]
    infos = [helper.make_tensor_value_info(name, FLOAT, shape) for name in (inner, before, rest, after)]
    number, go = (graph.unique(f"post/suppress/{name}") for name in ("round", "go"))
    body = helper.make_graph(
        copies, "round",
        [
            helper.make_tensor_value_info(number, TensorProto.INT64, []),
            helper.make_tensor_value_info(go, BOOL, []),
            *infos[:2],
        ],
        [helper.make_tensor_value_info(more, BOOL, []), *infos[2:]],
    )  # fmt: skip
    e("Loop", i64(_MOST_ROUNDS), np.array(True), left, taken, outputs=2, body=body)
    return str(graph.nodes[-1].output[1])


def strongest(e: Emit, scores: str, taken: str, most: str) -> tuple[str, str]:
    """Scores, (K,), and flat places, (K,) int64, of the `most` taken of the highest scores, ties in raster order."""
    found = e.cast(e("ReduceSum", taken, keepdims=0), INT64)
    k = e("Max", e("Min", found, most), i64(0))
    values = e.flat(e("Where", e("Greater", taken, f32(0)), scores, f32(-1)))
    return e.top(values, k, sort=True)
