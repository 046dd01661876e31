"""Reading an .onnx file that somebody else wrote."""

from __future__ import annotations

import os
from pathlib import Path

import onnx
from google.protobuf.message import DecodeError  # type: ignore[import-untyped]
from onnx import inliner

from elf_export.errors import ExportError
from elf_export.graph.graph import Graph, nested_graphs
from elf_export.graph.passes import sort_nodes, standard_ops
from elf_runtime.errors import first_line, reason
from elf_runtime.files.kind import HEAD, description, open_regular

from .guard import only_export_errors, shown_path
from .well_formed import require_well_formed


def load_model(path: str | os.PathLike[str]) -> onnx.ModelProto:
    """Read a model, with its external data, in the form that the passes expect.

    It is well formed, its nodes stand in the order in which they run, local functions are inlined, fused and quantised
    ops are written in standard ones, and initializers are no inputs (files of IR version 3 list them as both).

    Raises
    ------
    ExportError
        If the file is missing, no regular file, no ONNX model, a malformed one or larger than a protobuf file may be,
        or if its external data is not beside it.
    """
    with only_export_errors(path):
        return _loaded(Path(path))


def _loaded(file: Path) -> onnx.ModelProto:
    name = shown_path(file)
    try:
        if file.is_dir():
            raise ExportError(f"{name} is a folder, not an .onnx file")
        with open_regular(file) as opened:
            head = opened.read(HEAD)
            opened.seek(0)
            model = onnx.load(opened, load_external_data=False)
    except FileNotFoundError as error:
        raise ExportError(f"{name}: no such file") from error
    except DecodeError as error:
        what = description(head)
        why = f"it is {what}" if what else f"or cut off: {first_line(error)}"
        raise ExportError(f"{name}: not an ONNX model{':' if what else ','} {why}") from error
    except (OSError, ValueError) as error:
        raise ExportError(f"{name}: can't be read: {reason(error)}") from error
    if not model.graph.node:
        what = description(head)
        why = f": it is {what}" if what else ", or one without nodes"
        raise ExportError(f"{name}: not an ONNX model{why}")
    _load_external_data(model, file)
    _standard_domain(model)
    require_well_formed(model, name)
    if model.functions:
        model = inliner.inline_local_functions(model)
        require_well_formed(model, name)
    stored = {tensor.name for tensor in model.graph.initializer}
    inputs = [value for value in model.graph.input if value.name not in stored]
    del model.graph.input[:]
    model.graph.input.extend(inputs)
    return standard_ops(sort_nodes(Graph(model, copy=False))).model


def _standard_domain(model: onnx.ModelProto) -> None:
    """Call the standard domain by its short name, as onnx's tools look for it."""
    nodes = [node for graph in nested_graphs(model.graph) for node in graph.node]
    nodes += [node for function in model.functions for node in function.node]
    for named in (*nodes, *model.opset_import, *(entry for f in model.functions for entry in f.opset_import)):
        if named.domain == "ai.onnx":
            named.domain = ""


def _load_external_data(model: onnx.ModelProto, file: Path) -> None:
    """Take the tensors that lie in files beside the model into it."""
    name = shown_path(file)
    external = [
        tensor
        for graph in nested_graphs(model.graph)
        for tensor in (*graph.initializer, *(a.t for node in graph.node for a in node.attribute))
        if tensor.data_location == onnx.TensorProto.EXTERNAL
    ]
    if not external:
        return
    names = ", ".join(sorted({e.value for t in external for e in t.external_data if e.key == "location"})[:3])
    try:
        lengths = [int(e.value) for tensor in external for e in tensor.external_data if e.key == "length"]
        if sum(lengths) + model.ByteSize() > onnx.checker.MAXIMUM_PROTOBUF:
            raise ExportError(
                f"{name}: with its external data it has {sum(lengths) / 2**30:.1f} GiB; an ELF model is one file, of "
                "2 GiB at most.  Cut it before the layer first, with onnx.utils.extract_model"
            )
        onnx.load_external_data_for_model(model, str(file.parent))
    except (OSError, ValueError, onnx.checker.ValidationError) as error:
        raise ExportError(
            f"{name}: its weights are external data, in {names or 'no file'} beside it, which can't be read: {error}"
        ) from error
