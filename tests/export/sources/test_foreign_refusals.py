"""elf-export --onnx: models that can't be exported, and options that mean nothing with them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import helper

from elf_export import ExportError, VerificationError, build_saliency, export_network, export_onnx, load_model
from elf_export.cli import main
from elf_export.command.options import parser
from elf_export.request import Request
from elf_export.sources.foreign.prepare import prepare
from export import small_models as small
from export.sources.saved_models import saved


def test_what_onnx_refuses_is_an_export_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise onnx.checker.ValidationError("no such thing")

    monkeypatch.setattr(onnx.checker, "check_model", refuse)
    with pytest.raises(ExportError, match=r"refuses the graph that was built from this model: no such thing\."):
        build_saliency(small.nchw(), "relu2")


def test_what_is_no_model(tmp_path: Path) -> None:
    (tmp_path / "model.onnx").write_bytes(b"\xff\xff no model")
    with pytest.raises(ExportError, match="not an ONNX model"):
        load_model(tmp_path / "model.onnx")
    with pytest.raises(ExportError, match="no such file"):
        load_model(tmp_path / "none.onnx")
    with pytest.raises(ExportError, match=f"{tmp_path} is a folder, not an .onnx file"):
        load_model(tmp_path)


def test_a_fixed_size_has_no_working_scale(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("elf_export.pipeline.build_saliency", lambda *_, **__: pytest.fail("work was done"))
    message = r"takes images of 48x40 \(width x height\) only, .*: --set scale=0.5 can't be chosen, leave it out"
    with pytest.raises(ExportError, match=message):
        export_onnx(saved(small.classifier(), tmp_path), "logits", [], tmp_path / "elf.onnx", detection={"scale": 0.5})
    with pytest.raises(ExportError, match=message.replace("scale=0.5", "scales=0.5,1.0")):
        export_onnx(
            saved(small.classifier(), tmp_path), "logits", [], tmp_path / "b.onnx", detection={"scales": (1, 0.5)}
        )


def test_an_opset_that_the_model_can_t_become(tmp_path: Path) -> None:
    node = helper.make_node("LayerNormalization", ["x", "w"], ["y"], name="norm")
    model = small.model([node], {"w": np.ones(8, np.float32)}, (1, 3, 8, 8), "y")
    message = r"to 11: (?s:.*)Leave out --opset, which keeps 17, or export the model again with opset 11"
    with pytest.raises(ExportError, match=message):
        export_onnx(saved(model, tmp_path), "y", [], tmp_path / "elf.onnx", opset=11)


@pytest.mark.parametrize(
    ("body", "size", "reason"),
    [
        ("y = Log(n)", ("N", 3, "H", "W"), "it gives NaN or infinite values on noise"),
        ("y = Log(n)", (1, 3, 64, 64), "it gives NaN or infinite values on noise"),
        ("y = RandomNormalLike(n)", ("N", 3, "H", "W"), "it does not give what each of its images alone gives"),
    ],
)
def test_a_model_that_no_size_suits_says_why(body: str, size: tuple[int | str, ...], reason: str) -> None:
    model = small.written(f"r = Abs(x)  n = Neg(r)  {body}", {}, size)
    with pytest.raises(ExportError, match=f"runs the model at no size that was tried: {reason}$"):
        prepare(model, ["y"])


def test_a_wrong_gradient_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from elf_export.lowering import common, phases

    path = saved(small.nchw(), tmp_path)
    monkeypatch.setattr(common, "flipped", lambda weight, _: np.ascontiguousarray(weight.swapaxes(0, 1)))
    monkeypatch.setattr(phases, "transposed", lambda weight, _: weight[..., ::-1, ::-1].swapaxes(0, 1))
    with pytest.raises(VerificationError, match=r"(?s)disagrees with central differences.*No file was written"):
        export_onnx(path, "pool1", [], tmp_path / "elf.onnx")
    monkeypatch.chdir(tmp_path)
    assert main(["--onnx", str(path), "--layer", "pool1", "--desc", "none"]) == 1
    assert "white noise" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["model.onnx"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--net", "vgg", "--onnx", "a.onnx"], "--net and --onnx exclude each other"),
        (["--onnx", "a.onnx", "--weights", "w.npz"], "--weights goes with --net only"),
        (["--onnx", "a.onnx", "--offline"], "--offline goes with --net only"),
        (["--net", "vgg", "--mean", "1"], "--mean goes with --onnx only"),
        (["--net", "vgg", "--color", "rgb"], "--color goes with --onnx only"),
        (["--list", "--input", "x"], "--input goes with --onnx only"),
        (["--onnx", "a.onnx"], "--onnx needs --layer"),
        (["--onnx", "a.onnx", "--layer", "a"], "--onnx needs --desc"),
        (
            ["--onnx", "a.onnx", "--standardize", "--scale", "1/255"],
            "--standardize and --scale exclude each other",
        ),
        (["--onnx", "a.onnx", "--mean", "1,2"], "'1,2' has 2 numbers"),
        (["--onnx", "a.onnx", "--scale", "1/0"], "neither a number nor a fraction"),
        (["--onnx", "a.onnx", "--std", "0"], "--std has a zero"),
        (["--onnx", "a.onnx", "--color", "gray", "--mean", "1,2,3"], "--color gray has one channel"),
    ],
)
def test_options_that_do_not_go_together(options: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(options)
    assert caught.value.code == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: export_network(""), "unknown network ''"),
        (lambda: export_network(None), "give one of the two"),
        (lambda: export_network("vgg", preprocessing="junk"), "'paper', 'own' or a Preprocessing, not 'junk'"),
        (lambda: export_network("vgg", detection="scale=0.5"), "a DetectionParams or a dict, not 'scale=0.5'"),
        (lambda: export_network("vgg", reduction=8), r"such as Reduction\(128\), not 8"),
        (lambda: export_onnx("model.onnx", "pool1", None), "names of layers, or an empty list"),
        (lambda: export_onnx("model.onnx", "pool1", [], preprocessing="own"), "give a Preprocessing, not 'own'"),
        (
            lambda: export_onnx("model.onnx", "pool1", ["alexnet:pool1", "vgg:pool1"], desc_weights="a.npz"),
            "a.npz is of one network, and alexnet and vgg describe",
        ),
    ],
)
def test_library_arguments_that_mean_nothing(tmp_path, monkeypatch, call, message: str) -> None:
    saved(small.nchw(("N", 3, "H", "W")), tmp_path)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ExportError, match=message):
        call()


def test_the_command_says_what_a_command_can() -> None:
    words = Request(onnx="folder/a.onnx", layer="--p2", desc=("b",), calibration="pictures", precision="fp32").words()
    assert words == ["elf-export", "--onnx", "a.onnx", "--layer=--p2", "--desc", "b"]
    again = parser().parse_args(words[1:])
    assert (again.onnx, again.layer, again.desc) == ("a.onnx", "--p2", "b")
