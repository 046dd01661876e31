"""Small networks, what they are in 8 bits, and what rounding each of their values would give."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator

from elf_export.checks.float64 import in_double
from elf_export.dialect import is_own
from elf_export.dialect.reference import OPERATORS
from elf_export.graph.graph import Graph, GraphView
from elf_export.graph.passes import cut
from elf_export.lowering import write_steps
from elf_export.precision.int8.candidates import candidates
from elf_export.precision.int8.convolve import REST
from elf_export.precision.int8.scheme import Scheme, fitted
from elf_export.saliency import build_saliency
from seeded import LRN

Values = dict[str, np.ndarray]
ODD = 13, 19
Layers = list[str]
NETWORKS: dict[str, Layers] = {
    "convolutions": ["conv3", "relu", "conv3", "relu"],
    "vgg": ["conv3", "relu", "conv3", "relu", "pool", "conv3", "relu"],
    "pool last": ["conv3", "relu", "conv3", "relu", "pool"],
    "two pools": ["conv3", "relu", "pool", "conv3", "relu", "pool", "conv3"],
    "no relu": ["conv3", "conv3", "pool"],
    "strided": ["stride", "relu", "conv3", "relu"],
    "overlapping pool": ["conv3", "relu", "pool3", "conv3", "relu"],
    "padded": ["conv3", "pad", "conv3", "relu", "conv3"],
    "residual": ["conv3", "relu", "shortcut", "relu", "conv3", "relu"],
    "clipped": ["conv3", "clip", "conv3", "clip"],
    "normalized": ["conv3", "relu", "lrn", "pool3", "conv3", "relu"],
    "average": ["conv3", "relu", "average", "conv3", "relu"],
    "strided inside": ["conv3", "relu", "stride", "relu", "conv3", "relu"],
    "depthwise": ["conv3", "clip", "each stride", "clip", "conv3"],
    "depthwise first": ["each", "conv3", "relu", "conv3", "relu"],
    "padded pool": ["stride", "relu", "pool3 padded", "conv3", "relu"],
    "reaching pool": ["conv3", "relu", "pool3 ceil", "conv3", "relu"],
}
WIDTH = 8


def forward(layers: Layers, seed: int = 0) -> onnx.ModelProto:
    """x (N, 3, H, W) through the layers, seeded weights with biases; the values are v0, v1, ..."""
    rng = np.random.default_rng(seed)
    nodes, tensors, value, width = [], [], "x", 3
    for index, kind in enumerate(layers):
        out = f"v{index}"
        if kind in ("conv3", "stride", "shortcut", "each", "each stride"):
            per_group = 1 if kind.startswith("each") else width
            results = width if kind == "each" else WIDTH
            kernel = rng.standard_normal((results, per_group, 3, 3)) * np.sqrt(2 / (9 * per_group))
            bias = 0.2 * rng.standard_normal(results)
            tensors += [numpy_helper.from_array(kernel.astype(np.float32), f"{out}_w"),
                        numpy_helper.from_array(bias.astype(np.float32), f"{out}_b")]  # fmt: skip
            strides = [2, 2] if kind.endswith("stride") else [1, 1]
            made = f"{out}_conv" if kind == "shortcut" else out
            nodes.append(helper.make_node("Conv", [value, f"{out}_w", f"{out}_b"], [made], name=made,
                                          pads=[1] * 4, strides=strides, group=width // per_group))  # fmt: skip
            if kind == "shortcut":
                nodes.append(helper.make_node("Add", [made, value], [out], name=out))
            width = results
        elif kind == "relu":
            nodes.append(helper.make_node("Relu", [value], [out], name=out))
        elif kind == "clip":
            tensors += [numpy_helper.from_array(np.float32(v), f"{out}_{w}") for w, v in (("low", 0), ("high", 1))]
            nodes.append(helper.make_node("Clip", [value, f"{out}_low", f"{out}_high"], [out], name=out))
        elif kind == "pad":
            tensors.append(numpy_helper.from_array(np.array([0, 0, 1, 2, 0, 0, 2, 1]), f"{out}_pads"))
            nodes.append(helper.make_node("Pad", [value, f"{out}_pads"], [out], name=out))
        elif kind == "lrn":
            nodes.append(helper.make_node("LRN", [value], [out], name=out, size=3, alpha=0.5, beta=0.75))
        elif kind == "average":
            nodes.append(helper.make_node("AveragePool", [value], [out], name=out, kernel_shape=[2, 2], strides=[2, 2]))
        else:
            size = 3 if kind.startswith("pool3") else 2
            nodes.append(helper.make_node("MaxPool", [value], [out], name=out, kernel_shape=[size] * 2, strides=[2, 2],
                                          pads=[int("padded" in kind)] * 4, ceil_mode=int("ceil" in kind)))  # fmt: skip
        value = out
    image = helper.make_tensor_value_info("x", TensorProto.FLOAT, ["N", 3, "H", "W"])
    output = helper.make_tensor_value_info(value, TensorProto.FLOAT, None)
    graph = helper.make_graph(nodes, "net", [image], [output], tensors)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def saliency(layers: Layers, lowering: str = "int8") -> onnx.ModelProto:
    """With its masks as operations of `dialect`."""
    return build_saliency(forward(layers), f"v{len(layers) - 1}", [], "x", lowering=lowering, masks=True)


def written(model: onnx.ModelProto) -> onnx.ModelProto:
    """The model in standard operations."""
    return write_steps(Graph(model)).model


def images(size: tuple[int, int] = ODD, count: int = 2) -> np.ndarray:
    """Standard normal, with flat regions, where values tie."""
    rng = np.random.default_rng(1)
    x = rng.standard_normal((count, 3, *size)).astype(np.float32)
    x[-1, :, : size[0] // 2] = 0.5
    return x


def stepwise(
    model: onnx.ModelProto,
    x: np.ndarray,
    roundings: Mapping[str, Scheme] | None = None,
    inside: Collection[str] = (),
    steps: Collection[str] = (),
    codes: Mapping[str, np.ndarray] | None = None,
) -> tuple[Values, Values]:
    """Every value of the model in float64, node by node, and the integers of those in `roundings`.

    What is `inside` is rounded for convolutions alone, except those in `steps`.  Nodes go on from `codes`, integers
    that somebody else found: a difference is then that of one node.
    """
    evaluator = ReferenceEvaluator(in_double(model), new_ops=[LRN, *OPERATORS])
    values: Values = dict(evaluator.rt_inits_) | {"": None}  # type: ignore[dict-item]
    convolved: Values = {}
    integers: Values = {}

    def store(name: str, value: np.ndarray) -> None:
        scheme = (roundings or {}).get(name)
        exact = value
        if scheme is not None:
            code = np.minimum(np.maximum(np.round(value / scheme.scale) + scheme.zero, 0), 255)
            integers[name] = code
            code = code if codes is None else codes[name]
            # As the operator is specified, in float32: a comparison may depend on the last bit.
            value = (np.float32(code - float(scheme.zero)) * np.float32(scheme.scale)).astype(np.float64)
        convolved[name] = value
        values[name] = exact if name in inside else value

    store("x", x.astype(np.float64))
    for node in evaluator.rt_nodes_:
        first = node.op_type == "Conv" and node.output[0] not in steps
        given = [convolved.get(n, values[n]) if first and i == 0 else values[n] for i, n in enumerate(node.input)]
        if first and roundings and node.input[0] in inside and given[1].shape[1] == 2 * given[0].shape[1]:
            given[0] = with_rest(values[node.input[0]], given[0], roundings[node.input[0]])
        for name, value in zip(node.output, node.run(*given), strict=False):
            store(name, value)
    return values, integers


def schemes_of(model: onnx.ModelProto, x: np.ndarray) -> dict[str, Scheme]:
    values, _ = stepwise(model, x)
    return {name: fitted(values[name].astype(np.float32).ravel()) for name in candidates(GraphView(model))}


def session(model: onnx.ModelProto, path: Path | None = None, optimized: bool = True) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    options.intra_op_num_threads = 1
    levels = onnxruntime.GraphOptimizationLevel
    options.graph_optimization_level = levels.ORT_ENABLE_ALL if optimized else levels.ORT_DISABLE_ALL
    if path is not None:
        options.optimized_model_filepath = str(path)
    return onnxruntime.InferenceSession(written(model).SerializeToString(), options, ["CPUExecutionProvider"])


def with_values(model: onnx.ModelProto, names: list[str], x: np.ndarray) -> Values:
    """What ONNX Runtime computes for the values `names`."""
    part = cut(model, names)
    graph = Graph(part)
    for value in part.graph.output:
        value.CopyFrom(helper.make_tensor_value_info(value.name, graph.elem_type(value.name), None))
    return dict(zip(names, session(part).run(names, {"x": x}), strict=True))


def rounded_values(model: onnx.ModelProto) -> dict[str, Scheme]:
    """Value -> how the graph's QuantizeLinear nodes round it."""
    graph = Graph(model)
    found = {}
    for node in graph.nodes:
        if node.op_type == "QuantizeLinear":
            scale, zero = (graph.constant(name) for name in node.input[1:3])
            found[node.input[0]] = Scheme(float(scale), int(zero))
    return found


Network = tuple[onnx.ModelProto, onnx.ModelProto, np.ndarray]


def inside_of(lowered: onnx.ModelProto) -> set[str]:
    """Rounded values that other nodes read unrounded."""
    readers = Graph(lowered).consumers()
    return {v for v in rounded_values(lowered) if any(n.op_type != "QuantizeLinear" for n in readers[v])}


def complements_in(model: onnx.ModelProto) -> dict[str, str]:
    """Mask -> one minus it."""
    return {node.input[0]: node.output[0] for node in model.graph.node if is_own(node, "Complement")}


def steps_in(model: onnx.ModelProto) -> set[str]:
    """The differences that masks are steps of."""
    found = {node.input[0] for node in model.graph.node if is_own(node, "Step")}
    return {node.output[0] for node in model.graph.node if node.op_type == "Conv" and node.output[0] in found}


def with_rounded_weights(model: onnx.ModelProto, lowered: onnx.ModelProto) -> onnx.ModelProto:
    """Every Conv's kernel in 127 levels a channel.

    Those that stay in floats in `lowered` are left alone.
    """
    result, graph, made = onnx.ModelProto(), Graph(model), Graph(lowered)
    steps = steps_in(model) | {n.output[0] for n in made.nodes if n.op_type == "Conv" and made.is_constant(n.input[1])}
    result.CopyFrom(model)
    for node in result.graph.node:
        if node.op_type == "Conv" and node.output[0] not in steps:
            rounded = graph.constant(node.input[1]).astype(np.float64)
            rounded = in_127_levels(for_rests(rounded) if has_rests(lowered, node.input[0]) else rounded)
            node.input[1] = f"{node.output[0]}/127"
            result.graph.initializer.append(numpy_helper.from_array(rounded.astype(np.float32), node.input[1]))
    return result


def has_rests(lowered: onnx.ModelProto, x: str) -> bool:
    return any(node.output[0] == f"{x}/rest" for node in lowered.graph.node)


def with_rest(exact: np.ndarray, rounded: np.ndarray, scheme: Scheme) -> np.ndarray:
    """The rounded values, and behind them what that left, in steps of which `REST` are one."""
    rest = Scheme(scheme.scale / REST, scheme.zero).rounded(exact - rounded)
    return np.concatenate([rounded, REST * rest], axis=1)


def for_rests(kernel: np.ndarray) -> np.ndarray:
    return np.concatenate([kernel, kernel / REST], axis=1)


def in_127_levels(kernel: np.ndarray) -> np.ndarray:
    largest = np.abs(kernel).max(axis=(1, 2, 3), keepdims=True)
    step = np.where(largest > 0, largest, 1) / 63
    return np.asarray(np.round(kernel / step) * step)
