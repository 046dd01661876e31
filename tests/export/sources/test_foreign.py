"""elf-export --onnx on small models of every kind that other exporters write."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import helper

from elf_export import (
    ExportError,
    Preprocessing,
    Reduction,
    UnsupportedGraphError,
    build_gradient,
    export_onnx,
    load_model,
)
from elf_export.cli import main
from elf_runtime import ElfRuntime
from export import small_models as small
from export.sources.saved_models import saved
from helpers import ROOT, textured

MODELS = {
    "NCHW, fixed without need": (small.nchw(), "pool1", "relu2", (0, 0, 0, 1)),
    "free": (small.nchw(("n", 3, "h", "w")), "pool1", "relu2", (0, 0, 0, 1)),
    "the same symbol for both sizes": (small.nchw(("?", 3, "?", "?")), "pool1", "relu2", (0, 0, 0, 1)),
    "gray": (small.nchw((1, 1, 64, 64)), "pool1", "relu2", (0, 0, 0, 1)),
    "NHWC": (small.nhwc(), "pool1", "y", (0, 0, 0, 1)),
    "float16": (small.half_precision(), "pool1", "relu2", (0, 0, 0, 1)),
    "uint8": (small.bytes_in(), "pool1", "relu2", (0, 0, 0, 1)),
    "opset 9": (small.nchw(opset=9), "pool1", "relu2", (0, 0, 0, 1)),
    "opset 21": (small.nchw(opset=21), "pool1", "relu2", (0, 0, 0, 1)),
    "feature pyramid": (small.pyramid(), "y", "y", (0, 0, 0, 4)),
    "fully connected": (small.classifier(), "logits", "relu2", (40, 48, 0, 1)),
}


@pytest.mark.parametrize("name", MODELS)
def test_any_model_becomes_a_detector(tmp_path: Path, name: str) -> None:
    model, layer, descriptor, sizes = MODELS[name]
    result = export_onnx(saved(model, tmp_path), layer, [descriptor], tmp_path / "elf.onnx")
    spec = result.contract.input
    assert (spec.height, spec.width, spec.batch, spec.multiple) == sizes
    assert result.contract.parity["derivative_median_error"] < 1e-6
    written = onnx.load(result.path)
    assert written.ir_version <= 10
    assert next(o.version for o in written.opset_import) in range(11, 21)
    elf = ElfRuntime(result.path)
    image = textured(97, 131)
    found = elf.detect(image, border=4, nms_radius=3)
    assert len(found) > 10
    assert found.descriptors.shape == (len(found), 6 if name == "feature pyramid" else 4)
    assert (found.keypoints >= 0).all()
    assert (found.keypoints <= [130, 96]).all()
    assert elf.saliency(image).shape == (97, 131)
    batch = elf.detect_batch([image, image[:, ::-1].copy(), textured(64, 64)], border=4, nms_radius=3)
    assert np.allclose(batch[0].keypoints, found.keypoints)


def test_keypoints_of_a_fixed_size_lie_in_the_source_image(tmp_path: Path) -> None:
    """A spot of a 96x160 image is found where it is, although the network sees 48x40 pixels."""
    path = export_onnx(saved(small.tokens(), tmp_path), "tokens", [], tmp_path / "elf.onnx").path
    elf = ElfRuntime(path)
    image = np.full((160, 96, 3), 90, np.uint8)
    image[118:122, 58:62] = 255
    strongest = elf.detect(image, border=0, nms_radius=3).keypoints[0]
    assert strongest[0] == pytest.approx(59.5, abs=6)
    assert strongest[1] == pytest.approx(119.5, abs=12)  # a pixel of the network's is four of the image's
    with pytest.raises(ValueError, match=r"48x40 \(width x height\) only.*scale 0.5 can't be chosen"):
        elf.detect(image, scale=0.5)


def test_no_torch_is_needed(tmp_path: Path) -> None:
    """With torch hidden, the command lists and exports, and nothing has imported it."""
    path = saved(small.nhwc(), tmp_path)
    script = (
        "import sys\n"
        "class Hide:\n"
        "    def find_spec(self, name, *rest):\n"
        "        if name.split('.')[0] == 'torch': raise ImportError('hidden')\n"
        "sys.meta_path.insert(0, Hide())\n"
        "from elf_export.cli import main\n"
        f"assert main(['--onnx', {str(path)!r}, '--list']) == 0\n"
        f"sys.exit(main(['--onnx', {str(path)!r}, '--layer', 'pool1', '--desc', 'none', '-o', 'elf.onnx']))\n"
    )
    folders = ":".join(str(ROOT / name) for name in ("export", "runtime"))
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env={"PYTHONPATH": folders},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "median error" in done.stdout


def test_list(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--onnx", str(saved(small.nhwc(), tmp_path)), "--list"]) == 0
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert rows["pool1"].split()[1:7] == ["MaxPool", "6", "32x32", "2", "4", "px"]
    assert "100.0%" in rows["relu2"]


def test_list_marks_what_is_behind_an_op_without_a_rule(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nodes, tensors = small.convolutions()
    nodes[3] = helper.make_node("LpPool", ["pool1"], ["conv2"], name="odd", kernel_shape=[2, 2])
    del tensors["w2"]
    path = saved(small.model(nodes, tensors, (1, 3, 64, 64), "relu2"), tmp_path)
    assert main(["--onnx", str(path), "--list"]) == 0
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert "no gradient through LpPool" in rows["relu2"]
    assert "no gradient" not in rows["pool1"]
    with pytest.raises(UnsupportedGraphError, match=r"LpPool \(opset 17\) at node 'odd': no rule"):
        export_onnx(path, "relu2", [], tmp_path / "elf.onnx")


def test_an_elf_model_is_a_model_too(tmp_path: Path) -> None:
    first = export_onnx(saved(small.nchw(), tmp_path), "pool1", ["relu2"], tmp_path / "elf.onnx")
    again = export_onnx(first.path, "pool1", ["relu2"], tmp_path / "again.onnx")
    assert again.contract.layer == "pool1"
    assert again.contract.descriptors[0].dim == 4


def test_it_runs_on_the_smallest_image_of_its_contract(tmp_path: Path) -> None:
    """A linear layer at an eighth of the image: its adjoint and itself are no 5x5 kernel on a map of 4x4."""
    nodes = [
        helper.make_node("Conv", ["x", "w1"], ["conv1"], name="conv1", pads=[1] * 4),
        helper.make_node("Relu", ["conv1"], ["relu1"], name="relu1"),
        helper.make_node("MaxPool", ["relu1"], ["pool1"], name="pool1", kernel_shape=[8, 8], strides=[8, 8]),
        helper.make_node("Conv", ["pool1", "w2"], ["conv2"], name="conv2", pads=[1] * 4),
    ]
    tensors = {"w1": small.weights(4, 3, 3, 3), "w2": small.weights(64, 4, 3, 3)}
    path = saved(small.model(nodes, tensors, ("n", 3, "h", "w"), "conv2"), tmp_path)
    elf = ElfRuntime(export_onnx(path, "conv2", [], tmp_path / "elf.onnx").path)
    assert elf.contract.input.min_size == 32
    assert elf.saliency(textured(32, 36)).shape == (32, 36)


def test_external_data(tmp_path: Path) -> None:
    onnx.save(small.nchw(), tmp_path / "model.onnx", save_as_external_data=True, location="w.bin", size_threshold=0)
    assert export_onnx(tmp_path / "model.onnx", "pool1", [], tmp_path / "elf.onnx").path.exists()
    (tmp_path / "w.bin").unlink()
    with pytest.raises(ExportError, match=r"external data, in w\.bin beside it"):
        load_model(tmp_path / "model.onnx")


def test_gradients_of_both_layouts_agree() -> None:
    """The same weights with NCHW and NHWC inputs: the same numbers, transposed."""
    import onnxruntime as ort

    x = np.random.default_rng(0).standard_normal((1, 3, 64, 64)).astype(np.float32)
    results = []
    for source, pixels in ((small.nchw(), x), (small.nhwc(), x.transpose(0, 2, 3, 1))):
        session = ort.InferenceSession(build_gradient(source, "relu2").SerializeToString())
        results.append(session.run(["gradient"], {"x": np.ascontiguousarray(pixels)})[0])
    assert np.allclose(results[0], results[1].transpose(0, 3, 1, 2), atol=1e-6)


def test_preprocessing_options_reach_the_graph_and_the_contract(tmp_path: Path) -> None:
    path = saved(small.nchw(), tmp_path)
    options = ["--color", "bgr", "--scale", "1/255", "--mean", "0.4,0.5,0.6", "--std=0.2", "--opset", "18"]
    arguments = ["--onnx", str(path), "--layer", "pool1", "--desc", "relu2", *options]
    assert main([*arguments, "-o", str(tmp_path / "elf.onnx")]) == 0
    contract = ElfRuntime(tmp_path / "elf.onnx").contract
    assert contract.preprocessing == "bgr, (I * 0.00392157 - [0.4, 0.5, 0.6]) / [0.2]"
    assert "--mean=0.4,0.5,0.6" in contract.command
    assert "--opset 18" in contract.command
    assert contract.versions["opset"] == "18"
    gray = Preprocessing(color="gray")
    with pytest.raises(ExportError, match="color gray has 1 channel"):
        export_onnx(path, "pool1", [], tmp_path / "gray.onnx", preprocessing=gray)


def test_the_image_may_be_an_output_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = small.nchw(("N", 3, "H", "W"))
    model.graph.output.append(model.graph.input[0])
    assert main(["--onnx", str(saved(model, tmp_path)), "--list"]) == 0
    assert "relu2" in capsys.readouterr().out
    assert export_onnx(tmp_path / "model.onnx", "relu2", [], tmp_path / "elf.onnx").contract.stride == 2


@pytest.mark.usefixtures("one_direction")
def test_the_checks_are_in_the_result(tmp_path: Path) -> None:
    path = saved(small.nchw(("N", 3, "H", "W")), tmp_path)
    result = export_onnx(path, "pool1", ["relu2"], tmp_path / "elf.onnx", reduction=Reduction(3), precision="bf16")
    assert [type(check).__name__ for check in result.checks] == [
        "DifferencesCheck",  # the saliency's
        "ProjectionCheck",
        "PrecisionCheck",
    ]
    for check in result.checks:
        assert check.passed
        assert check.figures().items() <= result.contract.parity.items()
