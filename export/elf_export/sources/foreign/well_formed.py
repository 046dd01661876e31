"""Whether a model is one at all: every name defined once, every domain declared, every tensor of the size it states."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence

import onnx
from onnx import TensorProto, helper

from elf_export.errors import ExportError
from elf_export.graph.graph import bodies, captured, nested_graphs
from elf_runtime.errors import first_line

MOST_NODES = 200_000  # of a model whose local functions are written out
SHOWN = 80  # characters of a name in a message
LENIENT = frozenset({"Resize"})  # whose roi and scales every converter leaves out, although opset 11 asks for them
KERNELS = frozenset({"Conv", "ConvTranspose"})
REQUIRED = onnx.defs.OpSchema.FormalParameterOption.Single
PACKED = {  # bits of an element, where it is no whole number of bytes
    getattr(TensorProto, name, -1): bits
    for name, bits in (("INT4", 4), ("UINT4", 4), ("FLOAT4E2M1", 4), ("INT2", 2), ("UINT2", 2))
}


def require_well_formed(model: onnx.ModelProto, file: str) -> None:
    """Raise ExportError about the first thing that makes `model` no valid ONNX model.

    What is checked is what everything behind relies on; maps that do not fit together are found by ONNX Runtime, which
    runs the model before anything is made of it.
    """
    fault = next(_faults(model), None)
    if fault is not None:
        raise ExportError(f"{file}: not a valid ONNX model: {fault}")


def _faults(model: onnx.ModelProto) -> Iterator[str]:
    yield from _texts(model)
    yield from _domains(model)
    yield from _functions(model)
    for graph in nested_graphs(model.graph):
        yield from _tensors(graph)
    yield from _names(model.graph, set(), "")
    yield from _nodes(model)
    if not model.graph.output:
        yield "it has no output"
    for value in model.graph.input:
        kind = value.type.WhichOneof("value")
        if kind == "tensor_type" and value.type.tensor_type.elem_type not in TensorProto.DataType.values():
            yield f"its input {shown(value.name)} has the unknown type {value.type.tensor_type.elem_type}"


def _texts(model: onnx.ModelProto) -> Iterator[str]:
    """Names that are no text: protobuf gives their bytes, or raises."""
    try:
        names: list[object] = [entry.domain for entry in model.opset_import]
        for graph in nested_graphs(model.graph):
            names += [value.name for value in (*graph.input, *graph.output, *graph.initializer)]
            names += [d.dim_param for v in graph.input for d in v.type.tensor_type.shape.dim]
            for node in graph.node:
                names += [node.name, node.op_type, node.domain, *node.input, *node.output]
                names += [attribute.name for attribute in node.attribute]
        for function in model.functions:
            names += [function.name, function.domain]
    except UnicodeDecodeError as error:
        names = [bytes(error.object)]
    for name in names:
        if isinstance(name, bytes):
            yield f"the name {name[:SHOWN]!r} in it is not UTF-8 text"


def _domains(model: onnx.ModelProto) -> Iterator[str]:
    stated: dict[str, int] = {}
    for entry in model.opset_import:
        if stated.setdefault(entry.domain, entry.version) != entry.version:
            versions = f"{stated[entry.domain]} and {entry.version}"
            yield f"it names two versions of the opset {shown(entry.domain)}: {versions}"
    if "" not in stated:
        yield "it names no opset of standard ONNX (opset_import); set the one that it was written in"
    elif stated[""] < 1:
        yield f"it names opset {stated['']}, and there is none below 1"
    for graph in nested_graphs(model.graph):
        for node in graph.node:
            if not node.op_type:
                yield f"node {title(node)} names no op"
            elif node.domain not in stated:
                yield (
                    f"node {title(node)} is a {shown(node.op_type)} of the domain {shown(node.domain)}, for which it "
                    "names no opset (opset_import)"
                )


def _functions(model: onnx.ModelProto) -> Iterator[str]:
    """Local functions that call themselves, or that would make a model without end of a short file."""
    known = {(f.domain, f.name, getattr(f, "overload", "")): f for f in model.functions}
    sizes: dict[tuple[str, str, str], int] = {}

    def size(nodes: Sequence[onnx.NodeProto], above: tuple[tuple[str, str, str], ...]) -> int:
        total = 0
        for node in nodes:
            key = (node.domain, node.op_type, getattr(node, "overload", ""))
            if key in above:
                raise ExportError(f"its function {shown(key[1])} calls itself")
            if key in known and key not in sizes:
                sizes[key] = size(known[key].node, (*above, key))
            total += sizes.get(key, 1)
            total += sum(size(body.node, above) for body in bodies(node))
        return min(total, MOST_NODES + 1)

    try:
        total = size(model.graph.node, ())
    except ExportError as error:
        yield str(error)
        return
    if known and total > MOST_NODES:
        yield f"written out, its functions have more than {MOST_NODES} nodes"


def _tensors(graph: onnx.GraphProto) -> Iterator[str]:
    if graph.sparse_initializer:
        yield f"its weights {shown(graph.sparse_initializer[0].values.name)} are sparse; store them as a dense tensor"
    for tensor in graph.initializer:
        yield from _tensor(tensor, f"its tensor {shown(tensor.name)}")
    for node in graph.node:
        for attribute in node.attribute:
            where = f"the attribute {shown(attribute.name)} of node {title(node)}"
            if attribute.type not in onnx.AttributeProto.AttributeType.values() or not attribute.type:
                yield f"{where} is of no type"
            if attribute.ref_attr_name:
                yield f"{where} refers to {shown(attribute.ref_attr_name)}, of a function that it is not in"
            if attribute.HasField("t"):
                yield from _tensor(attribute.t, where)


def _tensor(tensor: TensorProto, where: str) -> Iterator[str]:
    dims = [int(d) for d in tensor.dims]
    if tensor.data_type not in TensorProto.DataType.values() or tensor.data_type == TensorProto.UNDEFINED:
        yield f"{where} is of the unknown type {tensor.data_type}"
        return
    if min(dims, default=0) < 0:
        yield f"{where} has the sizes {dims}"
        return
    count = math.prod(dims)
    if tensor.HasField("raw_data") and tensor.data_type != TensorProto.STRING:
        bits = PACKED.get(tensor.data_type) or 8 * helper.tensor_dtype_to_np_dtype(tensor.data_type).itemsize
        wanted, found, unit = -(-count * bits // 8), len(tensor.raw_data), "bytes"
    else:
        field = helper.tensor_dtype_to_field(tensor.data_type)
        per = 8 // PACKED[tensor.data_type] if tensor.data_type in PACKED else 1
        pairs = 2 if tensor.data_type in (TensorProto.COMPLEX64, TensorProto.COMPLEX128) else 1
        wanted, found, unit = -(-count // per) * pairs, len(getattr(tensor, field)), "values"
    if wanted != found:
        yield f"{where} of {'x'.join(map(str, dims)) or 'one value'} needs {wanted} {unit} and has {found}"


def _nodes(model: onnx.ModelProto) -> Iterator[str]:
    """Nodes of ops that this onnx knows whose inputs, outputs or attributes are not those of the op."""
    versions = {entry.domain: entry.version for entry in model.opset_import}
    context = onnx.checker.C.CheckerContext()
    context.ir_version, context.opset_imports = max(model.ir_version, 3), versions
    for graph in nested_graphs(model.graph):
        ranks = {tensor.name: len(tensor.dims) for tensor in graph.initializer}
        for node in graph.node:
            try:
                schema = onnx.defs.get_schema(node.op_type, versions[node.domain], node.domain)
            except onnx.defs.SchemaError:  # of another domain or a later opset: whoever runs it judges
                continue
            what = f"node {title(node)}, a {node.op_type},"
            for i, formal in enumerate(schema.inputs):
                left_out = not "".join(node.input[i : i + 1])
                if formal.option == REQUIRED and left_out and node.op_type not in LENIENT:
                    yield f"{what} lacks its input {formal.name}"
            if not (schema.min_input <= len(node.input) <= schema.max_input):
                yield f"{what} has {len(node.input)} inputs"
            if not (schema.min_output <= len(node.output) <= schema.max_output):
                yield f"{what} has {len(node.output)} outputs"
            if node.op_type in KERNELS and ranks.get(node.input[1], 3) < 3:
                yield f"{what} has a kernel of {ranks[node.input[1]]} axes"
            # A body reads what the checker would have to be told.
            if not bodies(node) and node.op_type not in LENIENT:
                try:
                    onnx.checker.check_node(node, context)
                except onnx.checker.ValidationError as error:
                    yield f"{what} is none: {first_line(error)}"


def _names(graph: onnx.GraphProto, outside: set[str], where: str) -> Iterator[str]:
    """Values that nobody makes, and those that two nodes make; `outside` are the values around a body."""
    inputs = [value.name for value in graph.input]
    stored = {tensor.name for tensor in graph.initializer}
    given, made = set(inputs) | stored, set[str]()
    if "" in inputs:
        yield f"an input{where} has no name"
    for what, names in (("inputs", inputs), ("constants", [tensor.name for tensor in graph.initializer])):
        if len(set(names)) != len(names):
            twice = next(name for name, count in Counter(names).items() if count > 1)
            yield f"two {what}{where} have the same name, {shown(twice)}"
    if "" in stored:
        yield f"a constant{where} has no name"
    for node in graph.node:
        for name in filter(None, node.output):
            if name in made:
                yield f"two nodes{where} make the value {shown(name)}"
            if name in given:
                yield f"node {title(node)}{where} makes {shown(name)}, which is an input or a constant already"
            made.add(name)
    known = outside | given | made
    for node in graph.node:
        for name in filter(None, [*node.input, *captured(node)]):
            if name not in known:
                yield f"node {title(node)}{where} reads {shown(name)}, which nothing makes"
        for body in bodies(node):
            yield from _names(body, known, f" in the body of {title(node)}")
    for value in graph.output:
        if value.name not in known:
            yield f"nothing makes the output {shown(value.name)}{where}"


def title(node: onnx.NodeProto) -> str:
    """What a message calls a node: its name, else its first output's, else its op."""
    return shown(node.name or next(iter(node.output), "") or node.op_type)


def shown(name: str) -> str:
    """A name for a message: quoted, on one line, of bounded length."""
    return repr(name if len(name) <= SHOWN else f"{name[:SHOWN]}...")
