"""elf-export --onnx on small models of every kind that other exporters write."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from elf_export import (
    ExportError,
    LayerError,
    Preprocessing,
    Reduction,
    UnsupportedGraphError,
    VerificationError,
    build_gradient,
    build_saliency,
    export_network,
    export_onnx,
    load_model,
)
from elf_export.command.main import main
from elf_export.command.options import parser
from elf_export.graph.graph import Graph
from elf_export.graph.passes import rename_values
from elf_export.request import Request
from elf_export.sources.foreign.image_input import find_image_input
from elf_export.sources.foreign.layers import resolve_layer
from elf_export.sources.foreign.prepare import prepare
from elf_export.sources.networks import get_network
from elf_runtime import ElfRuntime
from export import small_models as small
from helpers import ROOT, textured
from seeded import seeded_weights


def saved(model: onnx.ModelProto, folder: Path) -> Path:
    onnx.save(model, folder / "model.onnx")
    return folder / "model.onnx"


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
        "from elf_export.command.main import main\n"
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


@pytest.mark.parametrize(
    ("wanted", "value"),
    [
        ("relu1", "relu1"),
        ("block/relu1", "relu1"),
        ("ck/relu1", "relu1"),
        ("d/conv2", "conv2"),
        ("to_nchw", "t"),
    ],
)
def test_layers_are_found_by_value_node_or_end(wanted: str, value: str) -> None:
    assert resolve_layer(small.nhwc(), wanted) == value


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ("2", r"'2' is the end of 2 layers' names: 'conv2', 'relu2'; give more"),
        ("relu9", r"no layer 'relu9'; nearest are .*'relu1'"),
        ("CONV1", r"nearest are 'block/conv1', 'conv1'"),
        ("zzzzz", "no name is like it"),
        ("", "empty"),
    ],
)
def test_layers_that_are_not_found(wanted: str, message: str) -> None:
    with pytest.raises(LayerError, match=message):
        resolve_layer(small.nhwc(), wanted)


def two_images() -> onnx.ModelProto:
    result = small.nchw()
    second = helper.make_tensor_value_info("mask", TensorProto.FLOAT, (1, 1, 64, 64))
    result.graph.input.append(second)
    result.graph.node.append(helper.make_node("Mul", ["x", "mask"], ["masked"], name="masked"))
    return result


def test_which_input_is_the_image() -> None:
    with pytest.raises(ExportError, match="several inputs may be the image: x, mask; name it with --input"):
        find_image_input(two_images())
    assert find_image_input(two_images(), "mask").channels == 1
    with pytest.raises(ExportError, match=r"no input 'y'; it has\n  x: float \(1, 3, 64, 64\)"):
        find_image_input(two_images(), "y")
    with pytest.raises(ExportError, match=r"no input looks like an image.*\n  x: float \(1, 7, 64, 64\)"):
        find_image_input(small.nchw((1, 7, 64, 64)))
    free = find_image_input(small.nchw((1, 3, 64, 64)))
    assert (free.layout, free.size) == ("NCHW", (1, 64, 64))
    assert find_image_input(small.nhwc(("a", "b", "c", "d"))).layout == "NHWC"
    with pytest.raises(LayerError, match="needs more inputs than the image: 'mask'"):
        prepare(two_images(), ["masked"], "x")
    with pytest.raises(LayerError, match="'relu2' does not depend on the image 'mask'"):
        prepare(two_images(), ["relu2"], "mask")


OURS = {"image": "x", "saliency": "relu1", "gradient": "pool1", "descriptors_relu2": "conv2"}


@pytest.mark.parametrize("name", OURS)
def test_a_model_may_use_our_names(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """As its image input, its layer or any other value; the layers keep their names for the user."""
    path = saved(rename_values(Graph(small.nchw()), {OURS[name]: name}).model, tmp_path)
    layer = "pool1" if name == "image" else name
    assert main(["--onnx", str(path), "--list"]) == 0
    assert layer in capsys.readouterr().out
    exports = (layer, ["relu2", layer]), ("relu2", [layer])
    for detector, descriptors in exports:
        found = export_onnx(path, detector, descriptors, tmp_path / "elf.onnx", force=True)
        assert found.contract.layer == detector
        assert [d.layer for d in found.contract.descriptors] == descriptors
        elf = ElfRuntime(found.path)
        plain = export_onnx(
            saved(small.nchw(), tmp_path), OURS[name] if detector == name else detector, [], tmp_path / "plain.onnx",
            force=True,
        )  # fmt: skip
        saved(rename_values(Graph(small.nchw()), {OURS[name]: name}).model, tmp_path)
        image = textured(48, 64)
        assert np.allclose(elf.saliency(image), ElfRuntime(plain.path).saliency(image), atol=1e-6)


@pytest.mark.parametrize("name", ["image", "saliency", "gradient", "descriptors_pool1"])
def test_the_library_s_functions_take_our_names_too(name: str) -> None:
    """For the image, which is then called otherwise where an output has its name, and for F."""
    import onnxruntime as ort

    pixels = np.random.default_rng(0).standard_normal((1, 3, 64, 64)).astype(np.float32)

    def outputs(model: onnx.ModelProto) -> list[np.ndarray]:
        session = ort.InferenceSession(model.SerializeToString())
        return list(session.run(None, {session.get_inputs()[0].name: pixels}))

    for renamed in ("x", "relu2"):
        model = rename_values(Graph(small.nchw()), {renamed: name}).model
        layer = name if renamed == "relu2" else "relu2"
        for build, extra in ((build_gradient, ()), (build_saliency, (["pool1"],))):
            found, wanted = outputs(build(model, layer, *extra)), outputs(build(small.nchw(), "relu2", *extra))
            assert all(np.allclose(a, b, atol=1e-6) for a, b in zip(found, wanted, strict=True))
    names = [value.name for value in build_gradient(small.nchw(), "relu2").graph.output]
    assert names == ["relu2", "gradient"]
    with pytest.raises(LayerError, match="seed's input can't be called 'saliency'"):
        build_saliency(small.nchw(), "relu2", seed="saliency")


def test_an_elf_model_is_a_model_too(tmp_path: Path) -> None:
    first = export_onnx(saved(small.nchw(), tmp_path), "pool1", ["relu2"], tmp_path / "elf.onnx")
    again = export_onnx(first.path, "pool1", ["relu2"], tmp_path / "again.onnx")
    assert again.contract.layer == "pool1"
    assert again.contract.descriptors[0].dim == 4


def test_what_onnx_refuses_is_an_export_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise onnx.checker.ValidationError("no such thing")

    monkeypatch.setattr(onnx.checker, "check_model", refuse)
    with pytest.raises(ExportError, match=r"refuses the graph that was built from this model: no such thing\."):
        build_saliency(small.nchw(), "relu2")


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
    from elf_export.adjoint import phases
    from elf_export.adjoint.rules import conv

    path = saved(small.nchw(), tmp_path)
    for module in (conv, phases):
        monkeypatch.setattr(module, "flipped", lambda weight, _: np.ascontiguousarray(weight.swapaxes(0, 1)))
    with pytest.raises(VerificationError, match=r"(?s)disagrees with central differences.*No file was written"):
        export_onnx(path, "pool1", [], tmp_path / "elf.onnx")
    monkeypatch.chdir(tmp_path)
    assert main(["--onnx", str(path), "--layer", "pool1", "--desc", "none"]) == 1
    assert "white noise" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["model.onnx"]


def test_gradients_of_both_layouts_agree() -> None:
    """The same weights with NCHW and NHWC inputs: the same numbers, transposed."""
    import onnxruntime as ort

    x = np.random.default_rng(0).standard_normal((1, 3, 64, 64)).astype(np.float32)
    results = []
    for source, pixels in ((small.nchw(), x), (small.nhwc(), x.transpose(0, 2, 3, 1))):
        session = ort.InferenceSession(build_gradient(source, "relu2").SerializeToString())
        results.append(session.run(["gradient"], {"x": np.ascontiguousarray(pixels)})[0])
    assert np.allclose(results[0], results[1].transpose(0, 3, 1, 2), atol=1e-6)


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


@pytest.mark.usefixtures("small_probes")
def test_a_named_network_describes_what_anybody_s_model_finds(tmp_path: Path) -> None:
    """Its maps are those of the network alone, beside the model's own, and the command makes the file again."""
    path = saved(small.nchw(("N", 3, "H", "W")), tmp_path)
    assert main(["--onnx", str(path), "--layer", "pool1", "--desc", "vgg:pool1,relu2", "--offline", "--desc-dim", "4",
                 "-o", str(tmp_path / "elf.onnx")]) == 0  # fmt: skip
    contract = ElfRuntime(tmp_path / "elf.onnx").contract
    assert [(d.layer, d.dim, d.stride) for d in contract.descriptors] == [("vgg:pool1", 4, 2.0), ("relu2", 4, 2.0)]
    assert contract.input.color == "bgr"  # VGG's; the model's own RGB is made of it inside
    assert contract.weights.source.startswith("model.onnx; ")
    assert contract.command == (
        "elf-export --onnx model.onnx --layer pool1 --desc vgg:pool1,relu2 --desc-dim 4 --whiten 0.75 --color rgb "
        "--standardize"
    )
    result = export_onnx(path, "pool1", ["vgg:pool1", "relu2"], tmp_path / "b.onnx", offline=True)
    assert len(result.checks) == 1
    assert result.checks[0].passed
    both, image = ElfRuntime(result.path), textured(60, 80)
    alone = ElfRuntime(export_network("vgg", "pool1", ["pool1"], tmp_path / "vgg.onnx", offline=True).path)
    points = np.array([[20.0, 30.0], [41.5, 12.25]], np.float32)
    np.testing.assert_allclose(both.describe(image, points), alone.describe(image, points), atol=1e-5)
    plain = ElfRuntime(export_onnx(path, "pool1", ["relu2"], tmp_path / "c.onnx").path)
    np.testing.assert_allclose(both.saliency(image), plain.saliency(image), rtol=1e-4, atol=1e-6)
    with pytest.raises(LayerError, match=r"vgg has no layer 'pool9'"):
        export_onnx(path, "pool1", ["vgg:pool9"], tmp_path / "d.onnx")
    with pytest.raises(ExportError, match="no other network describes"):
        export_onnx(path, "pool1", ["relu2"], tmp_path / "d.onnx", desc_weights="a.pth")


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


def named_in_scope(scope: str) -> onnx.ModelProto:
    """Its values are called as TensorFlow does it, and as a named network's would be."""
    model = small.nchw(("N", 3, "H", "W"))
    names = {name: f"{scope}/{name}" for node in model.graph.node for name in node.output}
    names |= {tensor.name: f"{scope}/{tensor.name}" for tensor in model.graph.initializer}
    return rename_values(Graph(model), names).model


@pytest.mark.usefixtures("one_direction")
def test_another_network_s_values_have_names_of_their_own(tmp_path: Path) -> None:
    path = saved(named_in_scope("vgg"), tmp_path)
    result = export_onnx(path, "pool1", ["vgg:pool1"], tmp_path / "elf.onnx", offline=True, reduction=Reduction(4))
    names = [node.name for node in onnx.load(result.path).graph.node]
    assert len(names) == len(set(names))
    assert [spec.layer for spec in result.contract.descriptors] == ["vgg:pool1"]
    assert [type(check).__name__ for check in result.checks] == ["DifferencesCheck", "ProjectionCheck"]


def test_a_layer_of_the_model_s_own_comes_before_another_network_s(tmp_path: Path) -> None:
    model = small.nchw(("N", 3, "H", "W"))
    path = saved(rename_values(Graph(model), {"relu2": "scope/vgg:pool1"}).model, tmp_path)
    result = export_onnx(path, "pool1", ["vgg:pool1"], tmp_path / "elf.onnx", offline=True)
    assert [spec.layer for spec in result.contract.descriptors] == ["scope/vgg:pool1"]


def test_two_descriptors_of_one_output_are_refused(tmp_path: Path) -> None:
    model = small.nchw(("N", 3, "H", "W"))
    path = saved(rename_values(Graph(model), {"relu2": "vgg_pool1"}).model, tmp_path)
    with pytest.raises(LayerError, match="both be the output 'descriptors_vgg_pool1'"):
        export_onnx(path, "pool1", ["vgg_pool1", "vgg:pool1"], tmp_path / "elf.onnx", offline=True)


def alexnet_weights(folder: Path) -> Path:
    np.savez(folder / "alexnet.npz", **seeded_weights(get_network("alexnet").tensor_shapes(["pool5"])))
    return folder / "alexnet.npz"


def test_the_smallest_size_is_one_that_all_networks_take(tmp_path: Path) -> None:
    """AlexNet's pool5 of 32 pixels has windows larger than their map, at which ONNX Runtime divides by zero."""
    weights = alexnet_weights(tmp_path)
    path = saved(small.nchw(("N", 3, "H", "W")), tmp_path)
    result = export_onnx(path, "pool1", ["alexnet:pool5"], tmp_path / "elf.onnx", desc_weights=weights)
    alone = export_network("alexnet", "pool1", ["pool5"], tmp_path / "alexnet.onnx", weights=weights)
    assert result.contract.input.min_size == alone.contract.input.min_size > 32
    path = saved(small.classifier(), tmp_path)
    with pytest.raises(
        LayerError, match=r"alexnet describes images of \d+x\d+ pixels and more, and the model takes 48x40"
    ):
        export_onnx(path, "logits", ["alexnet:pool5"], tmp_path / "b.onnx", desc_weights=weights)


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
