"""The matching of descriptors as a graph of its own, as `elf_runtime.match` has it for vectors of unit length."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import helper

from elf_export.graph.graph import Graph

from .emit import DOUBLE, FLOAT, INT64, Emit, f32, f64, i64

OPSET = 17
IR_VERSION = 8  # that of the opset: what runtimes of its time load
FIRST, SECOND, RATIO = "descriptors_a", "descriptors_b", "ratio"
MATCHES, SIMILARITY = "matches", "similarity"


def match_graph(ratio: float = 0.9) -> onnx.ModelProto:
    """Mutual nearest neighbours of two sides' descriptors, with a ratio test; ties go to the lower index.

    Parameters
    ----------
    ratio : float
        The default of the input of that name.

    Returns
    -------
    onnx.ModelProto
        Inputs: ``descriptors_a`` (Ka, D) and ``descriptors_b`` (Kb, D) float32, of unit length, and with a default
        ``ratio`` float32 (): a match stays where the nearest distance |a - b| is below `ratio` times the second
        nearest, or there is no second; from 1 on all stay.  Ka and Kb may be 0.
        Outputs: ``matches`` (M, 2) int64, rows of the first and the second side, by ascending row of the first, and
        ``similarity`` (M,) float32, the product a . b.
    """
    infos = [helper.make_tensor_value_info(name, FLOAT, [rows, "D"]) for name, rows in ((FIRST, "Ka"), (SECOND, "Kb"))]
    infos.append(helper.make_tensor_value_info(RATIO, FLOAT, []))
    outputs = [
        helper.make_tensor_value_info(MATCHES, INT64, ["M", 2]),
        helper.make_tensor_value_info(SIMILARITY, FLOAT, ["M"]),
    ]
    default = onnx.numpy_helper.from_array(np.array(ratio, f32), RATIO)
    empty = helper.make_graph([], "elf-match", infos, outputs, [default])
    model = helper.make_model(empty, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)
    graph = Graph(model)
    _match(graph)
    onnx.checker.check_model(graph.model, full_check=True)
    return graph.model


def _match(graph: Graph) -> None:
    e = Emit(graph, "match")
    products = e("MatMul", FIRST, e("Transpose", SECOND, perm=[1, 0]))
    # One more row and two more columns, of nothing near: there is always a nearest and a second nearest.
    padded = e("Pad", products, np.array([0, 0, 1, 2], i64), f32(-np.inf))
    to_b, to_a = (e("ArgMax", padded, axis=axis, keepdims=0) for axis in (1, 0))
    two, _ = e.top(padded, i64(2), sort=True)
    best, second = (e("Gather", two, i64(column), axis=1) for column in (0, 1))
    rows = e.count(e.size(padded, 0))
    mutual = e("Equal", e("Gather", to_a, to_b), rows)
    keep = e.both(mutual, e("Greater", best, f32(-np.inf)), _far_enough(e, best, second))
    kept = e.flat(e("NonZero", keep))
    pairs = e("Concat", e.column(kept), e.column(e("Gather", to_b, kept)), axis=1)
    graph.op("Identity", pairs, name="post/outputs/matches", outputs=[MATCHES])
    graph.op("Identity", e("Gather", best, kept), name="post/outputs/similarity", outputs=[SIMILARITY])


def _far_enough(e: Emit, best: str, second: str) -> str:
    """Lowe's test, bool (Ka + 1,), of squared distances 2 - 2 a . b in float64."""
    near, far = (e("Max", e("Sub", f64(2), e("Mul", e.cast(x, DOUBLE), f64(2))), f64(0)) for x in (best, second))
    ratio = e.cast(RATIO, DOUBLE)
    passed = e("Less", near, e("Mul", e("Mul", ratio, ratio), far))
    return e("Or", passed, e("Not", e("Less", RATIO, f32(1))))
