"""ONNX models with one thing wrong: seeded, by the fields of the protobuf, so that every mutant is still one."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from itertools import count

import onnx
from onnx import AttributeProto, GraphProto, NodeProto, TensorProto, helper

LENGTHS = (0, 1, 2, 7, 64, 255, 20_000, 1 << 31, -1)  # of an axis
NUMBERS = (0, 1, -1, 2, 3, 1000, -(1 << 31), 1 << 40)  # of an attribute
TEXTS = ("", "x" * 300, "\u0000", "\x1b[31mred\x1b[0m", "../up", "näme", "a/b", " ")
OPS = ("Relu", "Conv", "Add", "Reshape", "MaxPool", "If", "Loop", "NoSuchOp", "Gemm", "Softmax", "Constant", "Cast",
       "Resize", "Expand", "Tile", "QuantizeLinear", "DequantizeLinear", "Identity", "Transpose", "Concat")  # fmt: skip
DOMAINS = ("", "ai.onnx", "ai.onnx.ml", "com.microsoft", "nobody.declared", "x" * 300)
TYPES = (*TensorProto.DataType.values(), 99)

Change = Callable[[onnx.ModelProto, random.Random], str | None]


def mutants(model: onnx.ModelProto, seed: int) -> Iterator[tuple[str, bytes]]:
    """Endless mutants of `model`: what was changed, in words, and the file's bytes.

    One change each, of a kind that is drawn evenly; the same seed gives the same ones.
    """
    rng = random.Random(seed)
    for number in count():
        copy = onnx.ModelProto()
        copy.CopyFrom(model)
        change = CHANGES[number % len(CHANGES)] if number < len(CHANGES) else rng.choice(CHANGES)
        try:
            what = change(copy, rng)
            data = copy.SerializeToString()
            if number % 25 == 24:
                name = rng.choice([n for n in _names(model.graph) if len(n) > 1]).encode()
                what, data = f"{name!r} is no UTF-8 text", model.SerializeToString().replace(name, name[:-1] + b"\xff")
        except (ValueError, TypeError):  # a number that its field does not hold
            continue
        if what:
            yield f"{number}: {what}", data


def _node(model: onnx.ModelProto, rng: random.Random) -> NodeProto:
    node: NodeProto = rng.choice(model.graph.node)
    return node


def _names(graph: GraphProto) -> list[str]:
    names = [value.name for value in (*graph.input, *graph.initializer)]
    return names + [name for node in graph.node for name in node.output]


def _name(model: onnx.ModelProto, rng: random.Random) -> str:
    return rng.choice([*_names(model.graph), *TEXTS, "nobody makes this"])


def _end(model: onnx.ModelProto, rng: random.Random) -> str | None:
    """An input or output of a node gets another name."""
    node = _node(model, rng)
    kind = rng.choice(("input", "output"))
    ends = getattr(node, kind)
    if not ends:
        return None
    place, name = rng.randrange(len(ends)), _name(model, rng)
    ends[place] = name
    return f"{kind} {place} of {node.name or node.op_type} is {name[:40]!r}"


def _ends(model: onnx.ModelProto, rng: random.Random) -> str | None:
    """A node loses an end, or gets one more."""
    node = _node(model, rng)
    kind = rng.choice(("input", "output"))
    ends = getattr(node, kind)
    if ends and rng.random() < 0.5:
        ends.pop()
        return f"{node.name or node.op_type} has an {kind} less"
    ends.append(_name(model, rng))
    return f"{node.name or node.op_type} has an {kind} more"


def _op(model: onnx.ModelProto, rng: random.Random) -> str:
    node = _node(model, rng)
    before, node.op_type = node.op_type, rng.choice((*OPS, *TEXTS))
    return f"{node.name or before} is a {node.op_type[:40]!r}"


def _domain(model: onnx.ModelProto, rng: random.Random) -> str:
    node = _node(model, rng)
    node.domain = rng.choice(DOMAINS)
    return f"{node.name or node.op_type} is of the domain {node.domain[:40]!r}"


def _node_name(model: onnx.ModelProto, rng: random.Random) -> str:
    node = _node(model, rng)
    node.name = rng.choice(TEXTS)
    return f"a {node.op_type} is called {node.name[:40]!r}"


def _gone(model: onnx.ModelProto, rng: random.Random) -> str:
    index = rng.randrange(len(model.graph.node))
    what = model.graph.node[index].op_type
    del model.graph.node[index]
    return f"node {index}, a {what}, is gone"


def _twice(model: onnx.ModelProto, rng: random.Random) -> str:
    node = _node(model, rng)
    copy = NodeProto()
    copy.CopyFrom(node)
    model.graph.node.append(copy)
    return f"{node.name or node.op_type} is there twice"


def _order(model: onnx.ModelProto, rng: random.Random) -> str:
    nodes = [NodeProto() for _ in model.graph.node]
    for copy, node in zip(nodes, model.graph.node, strict=True):
        copy.CopyFrom(node)
    rng.shuffle(nodes)
    del model.graph.node[:]
    model.graph.node.extend(nodes)
    return "the nodes are shuffled"


def _circle(model: onnx.ModelProto, rng: random.Random) -> str | None:
    node = _node(model, rng)
    if not node.input or not model.graph.node[-1].output:
        return None
    node.input[0] = model.graph.node[-1].output[0]
    return f"{node.name or node.op_type} reads the last node's result"


def _attribute(model: onnx.ModelProto, rng: random.Random) -> str | None:
    """An attribute gets another value, name or type."""
    owners = [node for node in model.graph.node if node.attribute]
    if not owners:
        return None
    node = rng.choice(owners)
    a: AttributeProto = rng.choice(node.attribute)
    way = rng.randrange(5)
    if way == 0:
        a.name = rng.choice((*TEXTS, "pads", "axis"))
    elif way == 1:
        a.type = rng.choice(AttributeProto.AttributeType.values())
    elif way == 2 and a.ints:
        a.ints[rng.randrange(len(a.ints))] = rng.choice(NUMBERS)
    elif way == 3 and a.ints:
        a.ints.pop()
    elif a.type == AttributeProto.INT:
        a.i = rng.choice(NUMBERS)
    elif a.type == AttributeProto.FLOAT:
        a.f = rng.choice((0.0, -1.0, float("nan"), float("inf"), 1e38))
    elif a.type == AttributeProto.STRING:
        a.s = rng.choice((b"", b"\xff\xfe", b"x" * 300, b"SAME_UPPER"))
    elif a.type == AttributeProto.INTS:
        del a.ints[:]
        a.ints.extend(rng.choices(NUMBERS, k=rng.randrange(9)))
    elif a.type == AttributeProto.TENSOR:
        _damage(a.t, rng)
    return f"attribute {a.name[:40]!r} of {node.name or node.op_type}, way {way}"


def _new_attribute(model: onnx.ModelProto, rng: random.Random) -> str:
    node = _node(model, rng)
    name = rng.choice(("axis", "pads", "group", "to", "perm", "kernel_shape", "strides", "nonsense", "body"))
    value = rng.choice((rng.choice(NUMBERS), [rng.choice(NUMBERS)] * rng.randrange(1, 9), "text", 0.5))
    node.attribute.append(helper.make_attribute(name, value))
    return f"{node.name or node.op_type} has the attribute {name} {value!r}"


def _opset(model: onnx.ModelProto, rng: random.Random) -> str:
    way = rng.randrange(4)
    if way == 0:
        del model.opset_import[:]
        return "no opset_import"
    if way == 1:
        model.opset_import.append(helper.make_opsetid(rng.choice(DOMAINS), rng.choice((1, 11, 17, 9999))))
        return f"opset_import {model.opset_import[-1].domain[:40]!r} {model.opset_import[-1].version} more"
    entry = rng.choice(model.opset_import)
    if way == 2:
        entry.version = rng.choice((0, -1, 1, 6, 9, 10, 11, 12, 13, 18, 21, 24, 99, 1 << 40))
        return f"opset {entry.version}"
    entry.domain = rng.choice(DOMAINS[2:])
    return f"the opset is of the domain {entry.domain[:40]!r}"


def _damage(tensor: TensorProto, rng: random.Random) -> str:
    way = rng.randrange(6)
    if way == 0 and tensor.dims:
        tensor.dims[rng.randrange(len(tensor.dims))] = rng.choice(LENGTHS)
    elif way == 1:
        tensor.data_type = rng.choice(TYPES)
    elif way == 2 and tensor.raw_data:
        tensor.raw_data = tensor.raw_data[: rng.randrange(len(tensor.raw_data))]
    elif way == 3 and tensor.raw_data:
        tensor.raw_data = bytes(rng.randrange(256) for _ in range(min(len(tensor.raw_data), 4096)))
    elif way == 4:
        tensor.dims.extend([1] * rng.randrange(1, 4) if rng.random() < 0.5 else [rng.choice(LENGTHS)])
    else:
        tensor.data_location = TensorProto.EXTERNAL
        entry = tensor.external_data.add()
        entry.key, entry.value = "location", rng.choice(("", "none.bin", "/etc/hostname", "../x", "\u0000"))
        entry = tensor.external_data.add()
        entry.key, entry.value = rng.choice(("offset", "length")), rng.choice(("-1", "1" * 40, "text"))
    return f"way {way}, {list(tensor.dims)} of type {tensor.data_type}"


def _tensor(model: onnx.ModelProto, rng: random.Random) -> str | None:
    if not model.graph.initializer:
        return None
    tensor: TensorProto = rng.choice(model.graph.initializer)
    return f"tensor {tensor.name}: {_damage(tensor, rng)}"


def _tensor_name(model: onnx.ModelProto, rng: random.Random) -> str | None:
    if not model.graph.initializer:
        return None
    tensor = rng.choice(model.graph.initializer)
    before, tensor.name = tensor.name, _name(model, rng)
    return f"tensor {before} is called {tensor.name[:40]!r}"


def _shape(model: onnx.ModelProto, rng: random.Random) -> str | None:
    """An input's or output's type or shape."""
    values = [*model.graph.input, *model.graph.output, *model.graph.value_info]
    if not values:
        return None
    value = rng.choice(values)
    kind, way = value.type.tensor_type, rng.randrange(6)
    dims = kind.shape.dim
    if way == 0:
        kind.elem_type = rng.choice(TYPES)
    elif way == 1 and dims:
        rng.choice(dims).dim_value = rng.choice(LENGTHS)
    elif way == 2 and dims:
        rng.choice(dims).dim_param = rng.choice(TEXTS)
    elif way == 3 and dims:
        dims.pop()
    elif way == 4:
        value.ClearField("type")
    else:
        for dim in dims:
            dim.dim_value = 20_000
    return f"{value.name}, way {way}: {[d.dim_value or d.dim_param[:40] for d in dims]}, type {kind.elem_type}"


def _graph_end(model: onnx.ModelProto, rng: random.Random) -> str:
    """The graph's own inputs and outputs: gone, twice, or called otherwise."""
    kind = rng.choice(("input", "output"))
    values = getattr(model.graph, kind)
    way = rng.randrange(4)
    if way == 0 or not values:
        del values[:]
    elif way == 1:
        values.add().CopyFrom(values[0])
    elif way == 2:
        values[0].name = _name(model, rng)
    else:
        values.append(helper.make_tensor_value_info(_name(model, rng), rng.choice((1, 7, 9, 10)), [1, 3, 8, 8]))
    return f"graph {kind}s, way {way}: {[value.name[:40] for value in values]}"


def _body(model: onnx.ModelProto, rng: random.Random) -> str:
    """A control-flow node with a body: sound, or reading what nobody makes, or without its outputs."""
    names = _names(model.graph)
    inside = rng.choice((rng.choice(names), "nobody makes this"))
    body = helper.make_graph(
        [helper.make_node("Identity", [inside], ["inside"])], "body", [],
        [helper.make_tensor_value_info(rng.choice(("inside", "missing")), 1, None)],
    )  # fmt: skip
    op = rng.choice(("If", "Loop", "Scan", "Relu"))
    attrs = {"then_branch": body, "else_branch": body} if op == "If" else {"body": body}
    before = rng.choice(names)
    node = helper.make_node(op, [before], ["made_by_body"], name="control", **attrs)
    model.graph.node.append(node)
    return f"{op} of {before} with a body that reads {inside}"


def _function(model: onnx.ModelProto, rng: random.Random) -> str:
    """A local function: sound, recursive, or one of a chain that doubles."""
    way, here = rng.randrange(3), [helper.make_opsetid("", 17), helper.make_opsetid("local", 1)]
    inner = [
        helper.make_node("Relu", ["a"], ["b"]),
        helper.make_node("F0", ["a"], ["b"], domain="local"),
        helper.make_node("F1", ["a"], ["b"], domain="local"),
    ][way]
    model.functions.append(helper.make_function("local", "F0", ["a"], ["b"], [inner], here))
    for i in range(1, 30 if way == 2 else 1):
        calls = [helper.make_node(f"F{(i + 1) % 30}", ["a"], ["c"], domain="local"),
                 helper.make_node(f"F{(i + 1) % 30}", ["c"], ["b"], domain="local")]  # fmt: skip
        model.functions.append(helper.make_function("local", f"F{i}", ["a"], ["b"], calls, here))
    model.opset_import.append(helper.make_opsetid("local", 1))
    node = _node(model, rng)
    node.domain, node.op_type = "local", "F0"
    del node.attribute[:]
    del node.input[1:]
    return f"{node.name} calls a function, way {way}"


def _version(model: onnx.ModelProto, rng: random.Random) -> str:
    model.ir_version = rng.choice((0, 1, 3, 4, 11, 99, -1))
    return f"ir_version {model.ir_version}"


def _sparse(model: onnx.ModelProto, rng: random.Random) -> str | None:
    if not model.graph.initializer:
        return None
    tensor = model.graph.initializer.pop(rng.randrange(len(model.graph.initializer)))
    sparse = model.graph.sparse_initializer.add()
    sparse.values.CopyFrom(tensor)
    sparse.indices.CopyFrom(helper.make_tensor("", TensorProto.INT64, [1], [rng.choice(NUMBERS)]))
    sparse.dims.extend([rng.choice(LENGTHS)])
    return f"tensor {tensor.name} is sparse"


def _large(model: onnx.ModelProto, rng: random.Random) -> str:
    """Constants that ask for a tensor of gigabytes."""
    length = rng.choice((100_000, 1 << 20, 1 << 40))
    shape = helper.make_tensor("vast", TensorProto.INT64, [2], [length, length])
    model.graph.initializer.append(shape)
    node = rng.choice((
        helper.make_node("ConstantOfShape", ["vast"], ["flood"], name="flood"),
        helper.make_node("Expand", [model.graph.input[0].name, "vast"], ["flood"], name="flood"),
        helper.make_node("Tile", [model.graph.input[0].name, "vast"], ["flood"], name="flood"),
    ))  # fmt: skip
    model.graph.node.insert(0, node)
    first = next(node for node in model.graph.node[1:] if node.input)
    if rng.random() < 0.5:
        first.input[0] = "flood"
    return f"{node.op_type} to {length} squared"


CHANGES: tuple[Change, ...] = (
    _end, _ends, _op, _domain, _node_name, _gone, _twice, _order, _circle, _attribute, _new_attribute, _opset, _tensor,
    _tensor_name, _shape, _graph_end, _body, _function, _version, _sparse, _large,
)  # fmt: skip
