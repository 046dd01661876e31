"""A quantised network as the float network that it stands for."""

from __future__ import annotations

import numpy as np
import onnx

from elf_export.graph.graph import Array, Graph, GraphView, attributes

QUANTIZERS = frozenset({"QuantizeLinear", "DequantizeLinear"})
# What only moves integers, or takes the largest: it does the same to the numbers that they stand for.
MOVES = frozenset({
    "Identity", "Reshape", "Flatten", "Squeeze", "Unsqueeze", "Transpose", "Slice", "Concat", "Split", "Expand", "Tile",
    "Gather", "MaxPool", "ReduceMax", "ReduceMin", "DepthToSpace", "SpaceToDepth", "Resize", "Upsample", "Pad",
})  # fmt: skip

Scale = tuple[Array, Array, int]  # scale, zero point and axis of a tensor of integers


def without_rounding(model: onnx.ModelProto) -> tuple[onnx.ModelProto, int]:
    """A copy of `model` that computes in floats what it computes in integers, and how many quantisers that replaces.

    The rounding of activations makes a staircase of a network: its derivative is zero, or, at a step, none.  Here
    integers are the numbers that they stand for, so that what was rounded is not; weights keep the values that they
    were rounded to, and activations saturate where the integers do, which often is their Relu.

    requires : constant scales, and integers that are only moved; any other model is returned as it is.
    call : before the adjoint.
    ensures : `model` is not changed.
    """
    count = sum(node.op_type in QUANTIZERS for node in model.graph.node)
    if not count:
        return model, 0
    read, graph = GraphView(model), Graph(model)
    scales: dict[str, Scale] = {}  # of the integers that are floats now
    for node, own in zip(read.nodes, list(graph.nodes), strict=True):
        if node.op_type in QUANTIZERS:
            with graph.replace_node(own):
                known = (_saturate if node.op_type == "QuantizeLinear" else _stand_for)(read, graph, node, scales)
        else:
            known = _moves(read, graph, own, scales)
        if not known:
            return model, 0
    del graph.model.graph.value_info[:]
    for output in graph.model.graph.output:
        if output.name in scales:
            output.type.tensor_type.elem_type = onnx.TensorProto.FLOAT
    graph.prune()
    return graph.model, count


def _scale_of(read: GraphView, node: onnx.NodeProto, integers: str) -> Scale | None:
    """What a quantiser's integers stand for, None if that is computed or not by 8 or 16 bits."""
    scale = read.constant(node.input[1])
    stated = node.input[2] if len(node.input) > 2 else ""
    kind = read.dtype(stated or integers)
    zero = read.constant(stated) if stated else np.zeros(1, kind)
    if scale is None or zero is None or kind.kind not in "iu" or "block_size" in attributes(node):
        return None
    return scale.astype(np.float64), zero, int(attributes(node).get("axis", 1))


def _saturate(read: GraphView, graph: Graph, node: onnx.NodeProto, scales: dict[str, Scale]) -> bool:
    """q = saturate(round(x / s) + z) stands for x between (q_min - z) s and (q_max - z) s."""
    x, q = node.input[0], node.output[0]
    found = _scale_of(read, node, q)
    if found is None:
        return False
    scale, zero, axis = found
    limits = np.iinfo(zero.dtype)
    low, high = ((limit - zero.astype(np.float64)) * scale for limit in (limits.min, limits.max))
    constant = read.constant(x)
    name = node.name or q
    if constant is not None:
        s, z = (_along(v, axis, constant.ndim) for v in (scale, zero.astype(np.float64)))
        steps = np.clip(np.round(constant / s) + z, limits.min, limits.max) - z
        graph.op("Identity", graph.const(steps * s, f"{name}/rounded", np.float32), name=name, outputs=[q])
    elif low.size == 1 and graph.opset >= 11:  # before, Clip's limits are attributes
        floor = graph.const(low.reshape(()), f"{name}/low", np.float32)
        ceiling = graph.const(high.reshape(()), f"{name}/high", np.float32)
        graph.op("Clip", x, floor, ceiling, name=name, outputs=[q])
    else:
        rank = read.rank(x)
        if rank is None:
            return False
        floor = graph.const(_along(low, axis, rank), f"{name}/low", np.float32)
        ceiling = graph.const(_along(high, axis, rank), f"{name}/high", np.float32)
        graph.op("Min", graph.op("Max", x, floor, name=f"{name}/raised"), ceiling, name=name, outputs=[q])
    scales[q] = found
    return True


def _stand_for(read: GraphView, graph: Graph, node: onnx.NodeProto, scales: dict[str, Scale]) -> bool:
    """x = (q - z) s, where q holds what its own scale and zero say already."""
    q, x = node.input[0], node.output[0]
    found = _scale_of(read, node, q)
    if found is None:
        return False
    constant, name = read.constant(q), node.name or x
    scale, zero, axis = found
    if constant is not None:
        s, z = (_along(v, axis, constant.ndim) for v in (scale, zero.astype(np.float64)))
        graph.op(
            "Identity", graph.const((constant.astype(np.float64) - z) * s, f"{name}/real", np.float32),
            name=name, outputs=[x],
        )  # fmt: skip
        return True
    if q not in scales:
        return False
    own_scale, own_zero, own_axis = scales[q]
    if np.array_equal(scale, own_scale) and np.array_equal(zero, own_zero):
        graph.op("Identity", q, name=name, outputs=[x])
        return True
    rank = read.rank(q) or 0
    s, s_own = _along(scale, axis, rank), _along(own_scale, own_axis, rank)
    z, z_own = (_along(v.astype(np.float64), a, rank) for v, a in ((zero, axis), (own_zero, own_axis)))
    factor = graph.const(s / s_own, f"{name}/factor", np.float32)
    shift = graph.const((z_own - z) * s, f"{name}/shift", np.float32)
    graph.op("Add", graph.op("Mul", q, factor, name=f"{name}/scaled"), shift, name=name, outputs=[x])
    return True


def _moves(read: GraphView, graph: Graph, node: onnx.NodeProto, scales: dict[str, Scale]) -> bool:
    """Whether a node leaves the integers among its inputs what they stand for; notes what its outputs stand for."""
    integers = [name for name in node.input if name in scales]
    if not integers:
        return True
    first = scales[integers[0]]
    data = node.input if node.op_type == "Concat" else node.input[:1]
    alike = all(name in scales and _same(scales[name], first) for name in data)
    if node.op_type not in MOVES or not alike or first[0].size > 1:
        return False
    if node.op_type == "Pad" and attributes(node).get("mode", "constant") == "constant":
        stated = node.input[2] if len(node.input) > 2 else ""
        fill = read.constant(stated) if stated else np.zeros(())
        if fill is None:
            return False
        real = (fill.astype(np.float64) - first[1].astype(np.float64).reshape(())) * first[0].reshape(())
        fill_name = graph.const(real.reshape(()), f"{node.name or node.output[0]}/fill", np.float32)
        graph.rewire(node, [*node.input[:2], fill_name, *node.input[3:]])
    scales.update((name, first) for name in node.output if name)
    return True


def _same(a: Scale, b: Scale) -> bool:
    return bool(np.array_equal(a[0], b[0]) and np.array_equal(a[1], b[1]) and a[2] == b[2])


def _along(value: Array, axis: int, rank: int) -> Array:
    """Shaped to broadcast along `axis`; a single number for all."""
    if value.size == 1:
        return value.reshape(())
    return value.reshape([-1] + [1] * (rank - 1 - axis % rank))
