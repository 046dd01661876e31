"""Reading an .onnx file that somebody else wrote."""

from __future__ import annotations

import os
from pathlib import Path

import onnx
from google.protobuf.message import DecodeError  # type: ignore[import-untyped]
from onnx import inliner

from elf_export.errors import ExportError
from elf_export.graph import nested_graphs


def load_model(path: str | os.PathLike[str]) -> onnx.ModelProto:
    """Read a model, with its external data, in the form that the passes expect.

    Local functions are inlined, and initializers are no inputs (files of IR version 3 list them as both).

    Raises
    ------
    ExportError
        If the file is missing, a folder, no ONNX model, its external data is not beside it, or it is larger than one
        protobuf file may be.
    """
    file = Path(path)
    if file.is_dir():
        raise ExportError(f"{file} is a folder, not an .onnx file")
    if not file.is_file():
        raise ExportError(f"{file}: no such file")
    try:
        model = onnx.load(file, load_external_data=False)
    except DecodeError as error:
        raise ExportError(f"{file}: not an ONNX model: {error}") from error
    if not model.graph.node:
        raise ExportError(f"{file}: not an ONNX model, or one without nodes")
    _load_external_data(model, file)
    if model.functions:
        model = inliner.inline_local_functions(model)
    stored = {tensor.name for tensor in model.graph.initializer}
    inputs = [value for value in model.graph.input if value.name not in stored]
    del model.graph.input[:]
    model.graph.input.extend(inputs)
    return model


def _load_external_data(model: onnx.ModelProto, file: Path) -> None:
    """Take the tensors that lie in files beside the model into it."""
    external = [
        tensor
        for graph in nested_graphs(model.graph)
        for tensor in graph.initializer
        if tensor.data_location == onnx.TensorProto.EXTERNAL
    ]
    if not external:
        return
    lengths = [int(e.value) for tensor in external for e in tensor.external_data if e.key == "length"]
    if sum(lengths) + model.ByteSize() > onnx.checker.MAXIMUM_PROTOBUF:
        raise ExportError(
            f"{file}: with its external data it has {sum(lengths) / 2**30:.1f} GiB; an ELF model is one file, of "
            "2 GiB at most.  Cut it before the layer first, with onnx.utils.extract_model"
        )
    try:
        onnx.load_external_data_for_model(model, str(file.parent))
    except (OSError, ValueError, onnx.checker.ValidationError) as error:
        names = sorted({e.value for tensor in external for e in tensor.external_data if e.key == "location"})
        raise ExportError(
            f"{file}: its weights are external data, in {', '.join(names[:3])} beside it, which can't be read: {error}"
        ) from error
