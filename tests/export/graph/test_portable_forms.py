"""Forms that onnxruntime-web's WebGPU computes rightly: an evaluator with its faults finds ONNX Runtime's values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
import onnxruntime as ort
import pytest
from onnx import TensorProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator
from onnx.reference.op_run import OpRun
from onnx.reference.ops.op_conv import Conv as RightConv

from elf_export.end_to_end.build import Form, end_to_end
from elf_export.graph.graph import Graph, attributes, nested_graphs
from elf_export.graph.passes import portable_forms
from elf_runtime import ElfRuntime
from elf_runtime.model import bundled_model

Array = npt.NDArray[Any]


class Conv(OpRun):
    """As onnxruntime-web 1.30 has it."""

    def _run(self, x: Array, w: Array, *bias: Array, **given: Any) -> tuple[Array, ...]:
        stated = attributes(self.onnx_node)
        assert {"dilations", "strides", "pads"} <= set(stated), "dilations should be 2D"
        unit = w.shape[2:] == (1, 1) and [1, 1] == stated["dilations"] == stated["strides"]
        if unit and stated["pads"][:2] == [0, 0]:
            given["pads"] = [0, 0, 0, 0]
        found: tuple[Array, ...] = RightConv._run(self, x, w, *bias, **given)
        return found


class Resize(OpRun):
    """Of a size that is rounded; nearest values, the only mode here."""

    def _run(self, x: Array, _: Array | None, scales: Array, **given: Any) -> tuple[Array]:
        axes = given.get("axes") or range(x.ndim)
        for axis, scale in zip(axes, scales, strict=True):
            places = np.floor(np.arange(np.floor(x.shape[axis] * scale + 0.5)) / scale).astype(int)
            x = x.take(np.minimum(places, x.shape[axis] - 1), axis)
        return (x,)


def model(nodes: Sequence[onnx.NodeProto], constants: dict[str, Array], opset: int = 17) -> onnx.ModelProto:
    graph = helper.make_graph(
        nodes, "g", [helper.make_tensor_value_info("x", TensorProto.FLOAT, ["N", 2, "H", "W"])],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, list("abcd"))],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )  # fmt: skip
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=8)


def runtime(model: onnx.ModelProto, x: Array) -> Array:
    options = ort.SessionOptions()
    options.log_severity_level = 3
    session = ort.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    found: Array = session.run(None, {"x": x})[0]
    return found


def web(model: onnx.ModelProto, x: Array) -> Array:
    found: Array = ReferenceEvaluator(model, new_ops=[Conv, Resize]).run(None, {"x": x})[0]
    return found


def portable(made: onnx.ModelProto) -> onnx.ModelProto:
    found: onnx.ModelProto = portable_forms(Graph(made)).model
    onnx.checker.check_model(found)
    return found


def check(made: onnx.ModelProto, faulty: bool = True) -> onnx.ModelProto:
    """ONNX Runtime's bits stay, and the evaluator with the faults finds them; before, it did not."""
    x = np.random.default_rng(0).standard_normal((1, 2, 9, 7)).astype(np.float32)
    after, wanted = portable(made), runtime(made, x)
    assert np.array_equal(runtime(after, x), wanted)
    np.testing.assert_allclose(web(after, x), wanted, rtol=1e-5, atol=1e-6)
    assert portable(after) == after
    if faulty:
        with pytest.raises(AssertionError):
            np.testing.assert_allclose(web(made, x), wanted, rtol=1e-5, atol=1e-6)
    return after


def conv(kernel: tuple[int, int], bias: bool = False, **given: Any) -> onnx.ModelProto:
    rng = np.random.default_rng(1)
    constants = {"w": rng.standard_normal((3, 2, *kernel)).astype(np.float32)}
    constants |= {"b": rng.standard_normal(3).astype(np.float32)} if bias else {}
    return model([helper.make_node("Conv", ["x", *constants], ["y"], name="c", **given)], constants)


@pytest.mark.parametrize("given", [{}, {"pads": [1, 0, 1, 2]}, {"strides": [2, 2], "kernel_shape": [3, 2]}])
def test_what_a_convolution_leaves_out_is_stated(given: dict[str, list[int]]) -> None:
    stated = attributes(check(conv((3, 2), **given)).graph.node[0])
    assert stated == {"dilations": [1, 1], "strides": [1, 1], "pads": [0, 0, 0, 0], **given}


@pytest.mark.parametrize("bias", [False, True])
@pytest.mark.parametrize("pads", [[0, 0, 1, 1], [0, 0, 0, 2]])
def test_padding_at_the_ends_of_1x1(pads: list[int], bias: bool) -> None:
    given = {"pads": pads, "strides": [1, 1], "dilations": [1, 1]}
    assert attributes(check(conv((1, 1), bias, **given)).graph.node[0])["dilations"] == [2, 2]


def test_convolutions_that_are_right_stay() -> None:
    plain = {"strides": [1, 1], "dilations": [1, 1]}
    for made in (conv((1, 1), pads=[1, 0, 1, 1], **plain), conv((1, 1), pads=[0, 0, 0, 0], **plain)):
        assert check(made, faulty=False) == made
    padded = conv((3, 2), auto_pad="SAME_UPPER")
    assert portable(padded) == padded


def test_convolutions_in_bodies_state_all() -> None:
    body = helper.make_graph(
        [helper.make_node("Conv", ["x", "w"], ["z"])],
        "b",
        [],
        [helper.make_tensor_value_info("z", TensorProto.FLOAT, list("abcd"))],
    )
    made = model(
        [helper.make_node("If", ["yes"], ["y"], then_branch=body, else_branch=body)],
        {"w": np.ones((1, 2, 2, 2), np.float32), "yes": np.array(True)},
    )
    check(made)


@pytest.mark.parametrize("precision", ["fp32", "int8"])
def test_the_bundled_models_are_written_so(precision: str) -> None:
    bundled = onnx.load(bundled_model(precision))
    assert portable(bundled) == bundled


@pytest.mark.parametrize("batch", [False, True])
def test_end_to_end_models_are_written_so(batch: bool) -> None:
    path = bundled_model("fp32")
    made = end_to_end(onnx.load(path), ElfRuntime(path).contract, Form(batch=batch))
    assert portable(made) == made
    convolutions = [node for graph in nested_graphs(made.graph) for node in graph.node if node.op_type == "Conv"]
    assert len(convolutions) > 45
    assert all({"dilations", "strides", "pads"} <= set(attributes(node)) for node in convolutions)


RESIZES: dict[str, Callable[[], onnx.ModelProto]] = {
    "scales": lambda: resize([1, 1, 0.3, 0.4]),
    "one axis": lambda: resize([1, 1, 1, 1.5]),
    "axes": lambda: resize([0.4, 0.3], 18, axes=[3, 2]),
}


def resize(scales: Sequence[float], opset: int = 17, **given: Any) -> onnx.ModelProto:
    given |= {"coordinate_transformation_mode": "asymmetric", "mode": "nearest", "nearest_mode": "floor"}
    node = helper.make_node("Resize", ["x", "", "scales"], ["y"], name="r", **given)
    return model([node], {"scales": np.array(scales, np.float32)}, opset)


@pytest.mark.parametrize("kind", RESIZES)
def test_a_resizing_has_the_floor_of_its_size(kind: str) -> None:
    assert check(RESIZES[kind]()).graph.node[-1].op_type == "Slice"


def test_resizings_that_are_right_stay_and_those_of_8_bits() -> None:
    whole = resize([1, 1, 2, 3])
    assert check(whole, faulty=False) == whole
    rounded = resize([1, 1, 0.4, 0.4])
    constants = [numpy_helper.from_array(np.float32(0.1), "scale"), numpy_helper.from_array(np.uint8(128), "zero")]
    rounded.graph.initializer.extend(constants)
    rounded.graph.node.append(helper.make_node("QuantizeLinear", ["y", "scale", "zero"], ["q"]))
    assert portable(rounded) == rounded
    node = helper.make_node("Resize", ["x", "", "", "sizes"], ["y"], name="r", mode="nearest")
    sized = model([node], {"sizes": np.array([1, 2, 4, 5], np.int64)})
    assert portable(sized) == sized
