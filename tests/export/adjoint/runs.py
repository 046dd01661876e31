"""Models of one node with their adjoint, and what runs them: ONNX Runtime, and ONNX's reference evaluator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
import onnxruntime
from onnx import TensorProto, helper
from onnx.reference import ReferenceEvaluator

from elf_export.adjoint import build_adjoint
from elf_export.dialect.reference import OPERATORS
from elf_export.graph.graph import Graph
from elf_export.lowering import lower, write_steps

from .stand_ins import STAND_INS

Array = npt.NDArray[Any]
IR_VERSION = 10


def one_graph(
    nodes: Sequence[onnx.NodeProto], infos: Sequence[onnx.ValueInfoProto],
    tensors: Sequence[onnx.TensorProto], opset: int, elem: int = TensorProto.FLOAT, output: str = "y",
) -> onnx.ModelProto:  # fmt: skip
    """A model with one output, of the shape that inference finds."""
    out = helper.make_tensor_value_info(output, elem, None)
    graph = helper.make_graph(list(nodes), "case", list(infos), [out], list(tensors))
    imports = [helper.make_opsetid("", opset)]
    model = helper.make_model(graph, opset_imports=imports, ir_version=IR_VERSION)
    out.CopyFrom(helper.make_tensor_value_info(output, elem, Graph(model).shape(output)))
    model.graph.output[0].CopyFrom(out)
    return model


def with_adjoint(model: onnx.ModelProto, wrt: str, output: str = "y", lowering: str | None = "fast") -> onnx.ModelProto:
    """`model` with the further input ``seed`` and output ``dx``; its operations of `dialect` written by `lowering`."""
    graph = Graph(model)
    seed = helper.make_tensor_value_info("seed", graph.elem_type(output), graph.shape(output))
    proto = graph.model.graph
    proto.input.append(seed)
    gradient = build_adjoint(graph, output, wrt, seed="seed")
    graph.op("Identity", gradient, name="result", outputs=["dx"])
    proto.output.append(helper.make_tensor_value_info("dx", graph.elem_type(wrt), graph.shape(wrt)))
    return graph.model if lowering is None else write_steps(lower(graph, lowering), lowering).model


def differentiated(graph: Graph, output: str, wrt: str, seed: str | None = None, lowering: str = "fast") -> str:
    """Append the gradient in standard operations, as `build_adjoint` appends it in those of `dialect`."""
    gradient = build_adjoint(graph, output, wrt, seed)
    write_steps(lower(graph, lowering, keep=[gradient]), lowering)
    return gradient


def run_ort(model: onnx.ModelProto, feed: Mapping[str, Array]) -> list[Array]:
    """Outputs in ONNX Runtime, one thread."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(model.SerializeToString(), options, ["CPUExecutionProvider"])
    outputs: list[Array] = session.run(None, dict(feed))
    return outputs


def run_reference(model: onnx.ModelProto, feed: Mapping[str, Array]) -> list[Array]:
    """Outputs in ONNX's reference evaluator, some of its ops replaced, `dialect`'s in numpy."""
    with np.errstate(all="ignore"):
        outputs: list[Array] = ReferenceEvaluator(model, new_ops=[*STAND_INS, *OPERATORS]).run(None, dict(feed))
    return outputs
