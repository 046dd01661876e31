"""elf-export --onnx on the forms that converters leave a model in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from elf_export import ExportError, LayerError, export_onnx
from elf_export.checks.arithmetic import computes_in_double
from elf_export.cli import main
from elf_export.graph.graph import Graph, captured
from elf_export.graph.passes import opset_of
from elf_export.sources.foreign.prepare import prepare
from elf_runtime import ElfRuntime
from export import small_models as small
from export.sources.saved_models import saved
from helpers import textured

pytestmark = pytest.mark.usefixtures("one_direction")


# -- GELU, and what the float64 evaluator rounds ---------------------------------------------------------------


def gelus(approximate: str) -> onnx.ModelProto:
    nodes, tensors = small.convolutions()
    nodes[1] = helper.make_node("Gelu", ["conv1"], ["relu1"], name="gelu1", approximate=approximate)
    nodes[4] = helper.make_node("Gelu", ["conv2"], ["relu2"], name="gelu2", approximate=approximate)
    return small.model(nodes, tensors, ("N", 3, "H", "W"), "relu2", opset=20)


@pytest.mark.parametrize("approximate", ["none", "tanh"])
def test_a_network_of_gelus(tmp_path: Path, approximate: str) -> None:
    parity = export_onnx(saved(gelus(approximate), tmp_path), "relu2", [], tmp_path / "elf.onnx").contract.parity
    assert parity["derivative_median_error"] < 1e-7
    assert "float32_median_error" in parity


def test_an_op_that_the_evaluator_rounds_does_not_make_a_right_gradient_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without our Gelu the evaluator's rounds to float32: then differences are taken in float32, by ONNX Runtime."""
    from elf_export.checks import float64

    ours = [op for op in float64.STAND_INS if op.__name__ != "Gelu"]
    assert len(ours) == len(float64.STAND_INS) - 1
    monkeypatch.setattr(float64, "STAND_INS", ours)
    lines: list[str] = []
    export_onnx(saved(gelus("none"), tmp_path), "relu2", [], tmp_path / "elf.onnx", log=lines.append)
    assert any("derivative of 1/2 |F|^2 in float32" in line for line in lines)


def test_what_computes_in_double_and_what_does_not() -> None:
    x = np.random.default_rng(0).standard_normal((2, 3, 8, 8))
    assert computes_in_double(lambda v: np.maximum(v, 0) ** 2, x)
    assert computes_in_double(np.round, x)
    assert not computes_in_double(lambda v: np.float32(v).astype(np.float64) ** 2, x)


# -- order and bodies ------------------------------------------------------------------------------------------


def test_nodes_that_are_not_sorted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = small.nchw()
    nodes = list(model.graph.node)[::-1]
    shuffled = small.model(nodes, {t.name: numpy_helper.to_array(t) for t in model.graph.initializer}, (1, 3, 64, 64),
                           "relu2")  # fmt: skip
    assert main(["--onnx", str(saved(shuffled, tmp_path)), "--list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()[3:]] == [
        "conv1", "relu1", "pool1", "conv2", "relu2",
    ]  # fmt: skip
    elf = ElfRuntime(export_onnx(tmp_path / "model.onnx", "relu2", [], tmp_path / "elf.onnx").path)
    plain = export_onnx(saved(small.nchw(), tmp_path), "relu2", [], tmp_path / "plain.onnx")
    assert np.array_equal(elf.saliency(textured(70, 90)), ElfRuntime(plain.path).saliency(textured(70, 90)))


def with_if() -> onnx.ModelProto:
    """A branch on the image's size behind the convolutions, whose bodies make values of their own."""
    nodes, tensors = small.convolutions()

    def body(name: str, factor: float) -> onnx.GraphProto:
        own = numpy_helper.from_array(np.float32(factor), f"{name}_factor")
        return helper.make_graph(
            [helper.make_node("Mul", ["relu2", f"{name}_factor"], [f"{name}_scaled"]),
             helper.make_node("Identity", [f"{name}_scaled"], [f"{name}_out"])],
            name, [], [helper.make_tensor_value_info(f"{name}_out", 1, None)], [own])  # fmt: skip

    nodes += [
        helper.make_node("Shape", ["x"], ["sizes"], name="sizes"),
        helper.make_node("Gather", ["sizes", "two"], ["height"], name="height", axis=0),
        helper.make_node("Greater", ["height", "many"], ["large"], name="large"),
        helper.make_node("If", ["large"], ["y"], name="branch", then_branch=body("a", 2.0), else_branch=body("b", 3.0)),
    ]
    tensors |= {"two": np.array(2), "many": np.array(100)}
    return small.model(nodes, tensors, ("N", 3, "H", "W"), "y")


def with_loop(sizes: list[int] | None) -> onnx.ModelProto:
    """A Loop that hands the sizes of a map on, to a Reshape before another convolution: their number is not stated."""

    def value(name: str, kind: int, shape: list[int] | None) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, kind, shape)

    body = helper.make_graph(
        [helper.make_node("Identity", ["go"], ["goes"]), helper.make_node("Identity", ["list"], ["same"])], "body",
        [value("i", 7, []), value("go", 9, []), value("list", 7, sizes)],
        [value("goes", 9, []), value("same", 7, sizes)],
    )  # fmt: skip
    nodes, tensors = small.convolutions()
    nodes += [
        helper.make_node("Shape", ["relu2"], ["sizes"], name="sizes"),
        helper.make_node("Loop", ["twice", "yes", "sizes"], ["kept"], name="kept", body=body),
        helper.make_node("Reshape", ["relu2", "kept"], ["r"], name="r"),
        helper.make_node("Conv", ["r", "w3"], ["y"], name="y", pads=[1] * 4),
    ]
    tensors |= {"twice": np.array(2), "yes": np.array(True), "w3": small.weights(5, 4, 3, 3, seed=3)}
    return small.model(nodes, tensors, ("N", 3, "H", "W"), "y")


@pytest.mark.parametrize("sizes", [None, [4]])
@pytest.mark.parametrize("layer", ["r", "y"])
def test_a_loop_on_the_path_of_sizes(tmp_path: Path, sizes: list[int] | None, layer: str) -> None:
    made = export_onnx(saved(with_loop(sizes), tmp_path), layer, ["y"], tmp_path / "elf.onnx")
    assert made.contract.parity["derivative_median_error"] < 1e-7
    assert (made.contract.descriptors[0].dim, made.contract.descriptors[0].stride) == (5, 2.0)
    found = ElfRuntime(made.path).detect(textured(90, 121))
    assert found.descriptors.shape == (len(found.keypoints), 5)


def test_what_a_body_makes_itself_is_not_captured() -> None:
    graph = Graph(with_if())
    assert set(captured(graph.producers()["y"])) == {"relu2"}
    assert [node.name for node in graph.consumers()["relu2"]] == ["branch", "branch"]


def test_a_control_flow_node_hides_nothing_before_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = saved(with_if(), tmp_path)
    assert main(["--onnx", str(path), "--list"]) == 0
    assert "relu2" in capsys.readouterr().out
    assert export_onnx(path, "relu2", ["pool1"], tmp_path / "elf.onnx").contract.layer == "relu2"
    with pytest.raises(ExportError, match=r"If \(opset 17\) at node 'branch': no rule"):
        export_onnx(path, "y", [], tmp_path / "branch.onnx")


# -- opsets ----------------------------------------------------------------------------------------------------


def neck(opset: int) -> onnx.ModelProto:
    """A map and a half as large one, enlarged to its run-time size and added: repeated or not, nobody knows before."""
    nodes = [
        helper.make_node("Conv", ["x", "w1"], ["a"], name="a", pads=[1] * 4, strides=[2, 2]),
        helper.make_node("Conv", ["a", "w2"], ["b"], name="b", pads=[1] * 4, strides=[2, 2]),
        helper.make_node("Shape", ["a"], ["size"], name="size"),
        helper.make_node("Resize", ["b", "none", "none", "size"], ["large"], name="large", mode="nearest",
                         coordinate_transformation_mode="asymmetric", nearest_mode="floor"),
        helper.make_node("Add", ["a", "large"], ["y"], name="y"),
    ]  # fmt: skip
    tensors = {"w1": small.weights(6, 3, 3, 3), "w2": small.weights(6, 6, 3, 3, seed=1)}
    tensors["none"] = np.zeros(0, np.float32)
    return small.model(nodes, tensors, ("N", 3, "H", "W"), "y", opset)


def test_an_opset_that_the_gradient_needs_is_converted_to(tmp_path: Path) -> None:
    lines: list[str] = []
    path = saved(neck(11), tmp_path)
    result = export_onnx(path, "y", ["y"], tmp_path / "elf.onnx", log=lines.append)
    assert result.contract.versions["opset"] == "13"
    assert "the model is of opset 11 and was converted to 13" in lines[0]
    with pytest.raises(ExportError, match="known at run time only; fix the input's size, or use opset 13 or later"):
        export_onnx(path, "y", [], tmp_path / "old.onnx", opset=11)
    lines.clear()
    plain = small.nchw(("N", 3, "H", "W"), opset=11)
    kept = export_onnx(saved(plain, tmp_path), "relu2", [], tmp_path / "kept.onnx", log=lines.append)
    assert kept.contract.versions["opset"] == "11"
    assert not any("converted" in line for line in lines)


# -- layers of integers ----------------------------------------------------------------------------------------


def with_integers() -> onnx.ModelProto:
    nodes, tensors = small.convolutions()
    nodes += [
        helper.make_node("ArgMax", ["relu2"], ["best"], name="best", axis=1),
        helper.make_node("Greater", ["relu2", "zero"], ["above"], name="above"),
        helper.make_node("Cast", ["relu2"], ["bytes"], name="bytes", to=TensorProto.UINT8),
    ]
    model = small.model(nodes, tensors | {"zero": np.float32(0)}, ("N", 3, "H", "W"), "relu2")
    for name, kind in (("best", TensorProto.INT64), ("above", TensorProto.BOOL), ("bytes", TensorProto.UINT8)):
        model.graph.output.append(helper.make_tensor_value_info(name, kind, None))
    return model


@pytest.mark.parametrize(("layer", "kind"), [("best", "int64"), ("above", "bool"), ("bytes", "uint8")])
def test_a_layer_of_integers_is_refused(tmp_path: Path, layer: str, kind: str) -> None:
    path = saved(with_integers(), tmp_path)
    for layers in ((layer, []), ("relu2", [layer])):
        with pytest.raises(LayerError, match=f"'{layer}' can be no layer: it holds {kind} values"):
            export_onnx(path, *layers, tmp_path / "elf.onnx")
    assert not (tmp_path / "elf.onnx").exists()


def test_the_list_marks_layers_of_integers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--onnx", str(saved(with_integers(), tmp_path)), "--list"]) == 0
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert "int64 values: no keypoints or descriptors from it" in rows["best"]
    assert "bool values" in rows["above"]
    assert "values" not in rows["relu2"]


def test_opset_of_a_converted_model() -> None:
    assert opset_of(prepare(neck(12), ["y"]).model) == 13
