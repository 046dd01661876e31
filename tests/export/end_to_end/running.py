"""Steps of the end-to-end graph as functions of arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import onnx
import onnxruntime as ort
from onnx import helper

from elf_export.end_to_end.emit import Emit
from elf_export.graph.graph import Graph

QUIET = ort.SessionOptions()
QUIET.log_severity_level = 3


def run(step: Callable[..., str | Sequence[str]], inputs: Mapping[str, np.ndarray], opset: int = 17) -> list[Any]:
    """What `step(Emit, *names of the inputs)` makes, by ONNX Runtime."""
    infos = [
        helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(x.dtype), [None] * x.ndim)
        for name, x in inputs.items()
    ]
    model = helper.make_model(
        helper.make_graph([], "step", infos, []), opset_imports=[helper.make_opsetid("", opset)], ir_version=8
    )
    graph = Graph(model)
    found = step(Emit(graph, "step"), *inputs)
    names = [found] if isinstance(found, str) else list(found)
    outputs = [graph.op("Identity", name, name=f"out{i}") for i, name in enumerate(names)]
    graph.set_outputs([onnx.ValueInfoProto(name=name) for name in outputs])
    session = ort.InferenceSession(graph.model.SerializeToString(), QUIET)
    return list(session.run(outputs, {name: np.asarray(x) for name, x in inputs.items()}))
