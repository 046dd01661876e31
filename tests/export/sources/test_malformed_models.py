"""Models that are none: one line that says what is wrong, from --list and from an export."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from elf_export import ExportError, export_onnx, load_model
from elf_export.cli import main
from elf_export.graph.graph import Graph
from elf_export.graph.passes import fold_constants
from export import small_models as small
from helpers import memory_needed_below

Change = Callable[[onnx.ModelProto], object]


def node(model: onnx.ModelProto, name: str) -> onnx.NodeProto:
    return next(node for node in model.graph.node if node.output[0] == name)


def tensor(model: onnx.ModelProto, name: str) -> TensorProto:
    return next(tensor for tensor in model.graph.initializer if tensor.name == name)


def function(*bodies: tuple[str, list[str]]) -> Change:
    """relu1 calls the first of local functions, each of which calls others one behind the other."""

    def change(model: onnx.ModelProto) -> None:
        imports = [helper.make_opsetid("", 17), helper.make_opsetid("local", 1)]
        for name, calls in bodies:
            names = ["a", *(f"v{i}" for i in range(len(calls) - 1)), "b"]
            made = [
                helper.make_node(op, [names[i]], [names[i + 1]], domain="" if op == "Relu" else "local")
                for i, op in enumerate(calls)
            ]
            model.functions.append(helper.make_function("local", name, ["a"], ["b"], made, imports))
        model.opset_import.append(helper.make_opsetid("local", 1))
        caller = node(model, "relu1")
        caller.domain, caller.op_type = "local", bodies[0][0]

    return change


def set_end(name: str, index: int, value: str, kind: str = "input") -> Change:
    return lambda model: getattr(node(model, name), kind).__setitem__(index, value)


def size(*dims: int) -> Change:
    def change(model: onnx.ModelProto) -> None:
        for dim, value in zip(model.graph.input[0].type.tensor_type.shape.dim, dims, strict=True):
            dim.dim_value = value

    return change


FAULTS: dict[str, tuple[Change, str]] = {
    "an input that nothing makes": (set_end("relu1", 0, "gone"),
                                    "node 'block/relu1' reads 'gone', which nothing makes"),
    "an output twice": (set_end("relu2", 0, "conv1", "output"), "two nodes make the value 'conv1'"),
    "an output that is a weight": (set_end("relu1", 0, "w2", "output"), "makes 'w2', which is an input or a constant"),
    "an output that is the image": (set_end("relu1", 0, "x", "output"), "makes 'x', which is an input or a constant"),
    "a circle": (set_end("conv1", 0, "pool1"), "waits for its own result, in a circle of nodes"),
    "a required input left out": (set_end("conv2", 1, ""), "node 'head/conv2', a Conv, lacks its input W"),
    "no opset": (lambda m: m.ClearField("opset_import"), "it names no opset of standard ONNX"),
    "opset 0": (lambda m: setattr(m.opset_import[0], "version", 0), "it names opset 0"),
    "two opsets": (lambda m: m.opset_import.append(helper.make_opsetid("", 12)),
                   "two versions of the opset '': 17 and 12"),
    "a domain that is not declared": (lambda m: setattr(node(m, "relu1"), "domain", "nobody"),
                                      "is a 'Relu' of the domain 'nobody', for which it names no opset"),
    "no op": (lambda m: setattr(node(m, "relu1"), "op_type", ""), "node 'block/relu1' names no op"),
    "a function that calls itself": (function(("F", ["F"])), "its function 'F' calls itself"),
    "functions in a circle": (function(("F", ["G"]), ("G", ["Relu", "F"])), "its function 'F' calls itself"),
    "functions without end": (function(*((f"F{i}", [f"F{i + 1}"] * 4) for i in range(12)), ("F12", ["Relu"])),
                              "written out, its functions have more than 200000 nodes"),
    "too few weights": (lambda m: setattr(tensor(m, "w1"), "raw_data", b"\0" * 12),
                        "its tensor 'w1' of 6x3x3x3 needs 648 bytes and has 12"),
    "a negative size": (lambda m: tensor(m, "w1").dims.__setitem__(0, -6),
                        "its tensor 'w1' has the sizes [-6, 3, 3, 3]"),
    "weights of terabytes": (lambda m: tensor(m, "w1").dims.__setitem__(0, 1 << 40), "needs"),
    "a type that is none": (lambda m: setattr(tensor(m, "w1"), "data_type", 99), "is of the unknown type 99"),
    "text for weights": (lambda m: setattr(tensor(m, "w1"), "data_type", TensorProto.STRING),
                         "needs 162 values and has 0"),
    "a kernel of one axis": (set_end("conv2", 1, "b1"), "node 'head/conv2', a Conv, has a kernel of 1 axes"),
    "an attribute of another type": (lambda m: node(m,
                                     "pool1").attribute.append(helper.make_attribute("dilations", 0.5)),
                                     "node 'pool1', a MaxPool, is none"),
    "a missing attribute": (lambda m: node(m, "pool1").ClearField("attribute"), "Required attribute 'kernel_shape'"),
    "an input too many": (lambda m: node(m, "relu1").input.append("w1"), "node 'block/relu1', a Relu, has 2 inputs"),
    "no output": (lambda m: m.graph.ClearField("output"), "it has no output"),
    "an output that nothing makes": (lambda m: setattr(m.graph.output[0], "name", "gone"),
                                     "nothing makes the output 'gone'"),
    "two inputs of one name": (lambda m: m.graph.input.append(m.graph.input[0]), "two inputs have the same name, 'x'"),
    "two constants of one name": (lambda m: m.graph.initializer.append(m.graph.initializer[0]),
                                  "two constants have the same name, 'w1'"),
    "a constant without a name": (lambda m: m.graph.initializer.add().CopyFrom(numpy_helper.from_array(np.ones(2))),
                                  "a constant has no name"),
    "sparse weights": (lambda m: (m.graph.sparse_initializer.add().values.CopyFrom(tensor(m, "b1")),
                                  m.graph.initializer.remove(tensor(m, "b1"))), "its weights 'b1' are sparse"),
    "a photograph of 20000 pixels": (size(1, 3, 20000, 20000),
                                     "1 image(s) of 20000x20000 pixels, as its file states, take 4.5"),
    "many images": (size(200_000, 3, 64, 64), "200000 image(s) of 64x64 pixels"),
    "maps beyond memory": (size(1, 3, 10000, 10000), "its node 'block/conv1' (Conv) alone reads and writes 3.35 GiB"),
    "pads beyond memory": (lambda m: node(m, "conv1").attribute[0].ints.__setitem__(slice(None), [50_000] * 4), "GiB"),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_a_malformed_model_is_refused_in_one_line(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change, message = FAULTS[name]
    model = small.nchw()
    change(model)
    (tmp_path / "bad.onnx").write_bytes(model.SerializeToString())
    for options in (["--list"], ["--layer", "relu2", "--desc", "none", "-o", str(tmp_path / "elf.onnx")]):
        with memory_needed_below(1e9):
            assert main(["--onnx", str(tmp_path / "bad.onnx"), *options]) == 1
        said = capsys.readouterr().err
        assert said.startswith("elf-export: error: ")
        assert message in said
        assert said.count("\n") == 1
        assert "can't be handled" not in said
    assert not (tmp_path / "elf.onnx").exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:1234\nsize 1\n", "it is a git-lfs pointer"),
        (b"<!DOCTYPE html>\n<html><body>404</body></html>", "it is a web page (HTML)"),
        (b"", "it is empty (0 bytes)"),
        (b"PK\x03\x04" + b"\0" * 60, "it is a zip archive"),
        (b"\0" * 4096, "it is nothing but zero bytes"),
        (small.nchw().SerializeToString()[:500], "not an ONNX model, or cut off"),
    ],
)
def test_another_file_than_a_model_is_called_what_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes, message: str
) -> None:
    (tmp_path / "other.onnx").write_bytes(content)
    for options in (["--list"], ["--layer", "y", "--desc", "none", "-o", str(tmp_path / "elf.onnx")]):
        assert main(["--onnx", str(tmp_path / "other.onnx"), *options]) == 1
        said = capsys.readouterr().err
        assert message in said
        assert said.count("\n") == 1


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.onnx")
    with pytest.raises(ExportError, match="not a file but a pipe"):
        load_model(tmp_path / "pipe.onnx")
    with pytest.raises(ExportError, match="not a file but a device"):
        load_model("/dev/zero")


def test_names_of_300_characters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a layer, where the new file's name is made of it; as the user's own name for it."""
    from elf_export.graph.passes import rename_values

    monkeypatch.chdir(tmp_path)
    long = "block/" * 60 + "relu"
    onnx.save(rename_values(Graph(small.nchw()), {"pool1": long}).model, "model.onnx")
    result = export_onnx("model.onnx", long, [])
    assert result.contract.layer == long
    assert result.path.name.startswith("elf-model-")
    assert result.path.name.endswith("block_relu.onnx")
    assert len(result.path.name) < 120
    with pytest.raises(ExportError, match="File name too long"):
        export_onnx("model.onnx", long, [], f"{'x' * 300}.onnx")
    with pytest.raises(ExportError, match=r"can't be read: File name too long|no such file"):
        load_model("x" * 300 + ".onnx")
    with pytest.raises(ExportError, match="null"):
        export_onnx("model.onnx", long, [], "elf\0.onnx")


def test_text_that_is_no_utf_8_in_an_attribute(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = small.nchw()
    node(model, "conv1").attribute.append(helper.make_attribute("auto_pad", b"\xff\xfe"))
    (tmp_path / "bad.onnx").write_bytes(model.SerializeToString())
    assert main(["--onnx", str(tmp_path / "bad.onnx"), "--layer", "relu2", "--desc", "none"]) == 1
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("name", ["relu1", "pads", "Relu", "w1", "block/relu1"])
def test_a_name_that_is_no_utf_8(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = small.nchw().SerializeToString().replace(name.encode(), name[:-1].encode() + b"\xff")
    (tmp_path / "bad.onnx").write_bytes(data)
    assert main(["--onnx", str(tmp_path / "bad.onnx"), "--list"]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "is not UTF-8 text" in said


def test_a_terminal_s_escapes_are_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from elf_export.graph.passes import rename_values

    name = "\x1b[31mred\r"
    onnx.save(rename_values(Graph(small.nchw()), {"pool1": name}).model, tmp_path / "model.onnx")
    assert main(["--onnx", str(tmp_path / "model.onnx"), "--list"]) == 0
    words = ["--layer", name, "--desc", "none", "-o", str(tmp_path / "elf.onnx")]
    assert main(["--onnx", str(tmp_path / "model.onnx"), *words]) == 0
    said = capsys.readouterr().out
    assert "\x1b" not in said
    assert "\r" not in said
    assert said.count(r"\x1b[31mred\r") == 2


@pytest.mark.parametrize("op", ["ConstantOfShape", "Expand", "Tile", "Range"])
def test_a_constant_beyond_memory_is_not_folded(op: str) -> None:
    """40 GB of zeros, written in two numbers."""
    nodes = {
        "ConstantOfShape": "vast = ConstantOfShape(shape)",
        "Expand": "vast = Expand(one, shape)",
        "Tile": "vast = Tile(square, shape)",
        "Range": "vast = Range(zero, many, step)",
    }
    tensors = {
        "shape": np.array([100_000, 100_000]), "one": np.float32([1]), "square": np.ones((1, 1), np.float32),
        "zero": np.array(0), "many": np.array(10**10), "step": np.array(1),
    }  # fmt: skip
    model = small.written(f"{nodes[op]}  y = Identity(vast)", tensors, (1, 3, 8, 8))
    assert [n.op_type for n in fold_constants(Graph(model)).nodes] == [op, "Identity"]


def test_the_opset_of_the_standard_domain_by_its_long_name(tmp_path: Path) -> None:
    model = small.nchw()
    for n in model.graph.node:
        n.domain = "ai.onnx"
    onnx.save(model, tmp_path / "model.onnx")
    assert export_onnx(tmp_path / "model.onnx", "relu2", [], tmp_path / "elf.onnx").path.exists()
