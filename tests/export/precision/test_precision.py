"""`--precision` and `--set`: fewer bits as a user asks for them, what is said of them, and what is refused."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from elf_export import ExportError, export_network, export_onnx
from elf_export.calibration import calibration_set
from elf_export.checks import lower_precision
from elf_export.command.main import main
from elf_export.command.options import parser, setting
from elf_export.detection import changed, chosen
from elf_export.graph.graph import Graph
from elf_export.graph.passes import opset_of
from elf_export.precision.half import MANY, bfloat16_weights, half_precision
from elf_export.request import Request
from elf_export.sources.networks import get_network
from elf_runtime import DetectionParams, ElfRuntime, InputSpec
from elf_runtime.model.session import open_session
from export import small_models as small
from helpers import shared, textured
from seeded import seeded_weights

SHARED = {
    "vgg": "vgg16_oxford_imagenet.npz",
    "alexnet": "alexnet_caffe_conv_8bit.npz",
    "xception": "xception_imagenet_entry_flow.npz",
    "squeezenet": "squeezenet1_1_imagenet_keras.npz",
    "superpoint": "superpoint_v1_encoder_descriptor.npz",
}


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    for seed in range(2):
        cv2.imwrite(str(folder / f"{seed}.png"), textured(150, 200, seed))
    return folder


def weights_of(name: str, folder: Path) -> Path:
    if name in SHARED:
        return shared("weights", SHARED[name])
    network = get_network(name)
    path = folder / "seeded.npz"
    np.savez(path, **seeded_weights(network.tensor_shapes([network.default_layer, *network.default_descriptors])))
    return path


def test_the_share_is_of_the_points_that_are_looked_for() -> None:
    points = np.array([[0.0, 0.0], [50.0, 50.0], [9.0, 9.0], [20.0, 21.0]], np.float32)
    others = np.array([[0.6, 0.8], [20.0, 20.0]], np.float32)
    assert lower_precision._near(points, others) == 0.5
    assert lower_precision._near(others, points) == 1.0
    assert (lower_precision._near(points[:0], others), lower_precision._near(points, others[:0])) == (1.0, 0.0)


# -- named networks ------------------------------------------------------------------------------------------------

# Least correlation of the saliency with float32's on two drawn pictures.
LEAST = {"int8": 0.8, "fp16": 0.99, "bf16": 0.97}


@pytest.mark.usefixtures("small_probes")
@pytest.mark.parametrize(
    ("name", "precision"),
    [
        (name, precision)
        for name in ("alexnet", "xception", "squeezenet", "resnet18", "mobilenet_v2")
        for precision in LEAST
        if (name, precision) != ("alexnet", "int8")
    ],
)
def test_named_networks(tmp_path: Path, pictures: Path, name: str, precision: str) -> None:
    said: list[str] = []
    result = export_network(
        name, output=tmp_path / "a.onnx", weights=weights_of(name, tmp_path), precision=precision,
        calibration=pictures, log=said.append,
    )  # fmt: skip
    elf = ElfRuntime(result.path)
    assert elf.contract.precision == precision
    assert elf.contract.parity["lower_correlation"] > LEAST[precision]
    assert elf.contract.parity["keypoint_agreement"] >= 0.99  # float32's, against torch
    assert f"--precision {precision}" in elf.contract.command
    header, fp32, lower, *_ = said[-1].splitlines()
    assert header.split()[:7] == ["correlation", "kpts", "<", "1", "px", "keypoints", "rep"]
    assert (fp32.split()[0], lower.split()[0]) == ("fp32", precision)
    image = textured(131, 171, 7)
    found = elf.detect(image, threshold="none")
    assert len(found) > 20
    assert np.isfinite(found.descriptors).all()
    assert elf.saliency(image).dtype == np.float32


@pytest.mark.usefixtures("small_probes")
@pytest.mark.parametrize(
    ("name", "precision", "message"),
    [
        ("superpoint", "int8", "make no convolution of this network faster; use fp32, fp16 or bf16"),
        ("alexnet", "int8", "int8: 8-bit integers make no convolution of this network faster"),
        ("superpoint", "fp16", r"fp16 overflows in this network: its saliency is not finite\. No file was written"),
    ],
)
def test_what_a_network_does_not_survive(
    tmp_path: Path, pictures: Path, name: str, precision: str, message: str
) -> None:
    """SuperPoint's conv1a is one linear layer of large weights: 25 multiplications a pixel, up to 350000 each.

    AlexNet's response normalisation stays in floats, between its few convolutions.
    """
    with pytest.raises(ExportError, match=message):
        export_network(
            name, descriptors=[], output=tmp_path / "a.onnx", weights=weights_of(name, tmp_path),
            precision=precision, calibration=pictures,
        )  # fmt: skip
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("small_probes")
def test_the_command_in_the_file_makes_it_again(
    tmp_path: Path, pictures: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    first = ["--net", "vgg", "--layer", "pool1", "--desc", "pool1", "--offline", "--precision", "int8"]
    settings = ["--set", "scale=0.5", "--set", "denoise=3,0.8", "--set", "subpixel=true", "--set", "threshold=none"]
    assert main([*first, *settings, "--calibration", str(pictures), "-o", "first.onnx"]) == 0
    contract = ElfRuntime("first.onnx").contract
    own = get_network("vgg").detection
    assert contract.detection == own.updated(scale=0.5, denoise=(3, 0.8), subpixel=True, threshold="none")
    program, *words = shlex.split(contract.command)
    assert program == "elf-export"
    assert main([*words, "--offline", "-o", "second.onnx"]) == 0
    assert Path("first.onnx").read_bytes() == Path("second.onnx").read_bytes()


@pytest.mark.parametrize("precision", ["int8", "fp16", "bf16"])
def test_anyone_s_model(tmp_path: Path, pictures: Path, precision: str) -> None:
    nodes, tensors = small.convolutions()
    tensors = {"w1": small.weights(32, 3, 3, 3), "b1": small.weights(32), "w2": small.weights(32, 32, 3, 3)}
    onnx.save(small.model(nodes, tensors, ("n", 3, "h", "w"), "relu2"), tmp_path / "model.onnx")
    result = export_onnx(
        tmp_path / "model.onnx", "relu2", ["relu2"], tmp_path / "elf.onnx", precision=precision, calibration=pictures
    )
    assert result.contract.precision == precision
    assert result.contract.parity["lower_correlation"] > LEAST[precision]


def test_a_model_that_would_be_slower_in_8_bits_is_refused(tmp_path: Path, pictures: Path) -> None:
    """Six channels, then four: rounding costs more than so few multiplications."""
    onnx.save(small.nchw(("n", 3, "h", "w")), tmp_path / "model.onnx")
    with pytest.raises(ExportError, match="make no convolution of this network faster; use fp32"):
        export_onnx(
            tmp_path / "model.onnx", "relu2", ["relu2"], tmp_path / "elf.onnx", precision="int8", calibration=pictures
        )
    assert not (tmp_path / "elf.onnx").exists()


# -- float16 and bfloat16 ----------------------------------------------------------------------------------------


def test_float16_throughout_and_half_the_bytes(vgg) -> None:
    lowered = half_precision(vgg.model)
    onnx.checker.check_model(lowered, full_check=True)
    assert lowered.ByteSize() < 0.51 * vgg.model.ByteSize()
    graph = Graph(lowered)
    inner = {v for node in graph.nodes if not node.name.startswith("pre/") for v in node.output}
    singles = {v for v in inner if graph.dtype(v) == np.float32}
    assert singles == {value.name for value in lowered.graph.output}
    assert {value.type.tensor_type.elem_type for value in (*lowered.graph.input, *lowered.graph.output)} == {
        TensorProto.FLOAT
    }
    assert not any(node.op_type == "HardSigmoid" for node in lowered.graph.node)


def test_tensors_in_attributes_are_float16_too() -> None:
    """The value that a ConstantOfShape repeats; a Constant that Resize reads stays, as its scales are float32."""
    nodes = [
        helper.make_node("Shape", ["x"], ["shape"], name="shape"),
        helper.make_node("ConstantOfShape", ["shape"], ["half"], name="half",
                         value=numpy_helper.from_array(np.array([0.5], np.float32))),
        helper.make_node("Add", ["x", "half"], ["sum"], name="sum"),
        helper.make_node("Constant", [], ["scales"], name="scales",
                         value=numpy_helper.from_array(np.array([1, 1, 2, 2], np.float32))),
        helper.make_node("Resize", ["sum", "", "scales"], ["y"], name="y", mode="nearest"),
    ]  # fmt: skip
    infos = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["N", 3, None, None]) for name in "xy"]
    graph = helper.make_graph(nodes, "g", infos[:1], infos[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    lowered = half_precision(model)
    onnx.checker.check_model(lowered, full_check=True)
    x = np.arange(12, dtype=np.float32).reshape(1, 3, 2, 2)
    (found,) = open_session(lowered.SerializeToString())[0].run(None, {"x": x})
    np.testing.assert_array_equal(found, (x + 0.5).repeat(2, 2).repeat(2, 3))


def test_steps_are_exact_in_float16() -> None:
    """[d > 0] for every float16 there is, the smallest included."""
    every = np.arange(2**16, dtype=np.uint16).view(np.float16)
    values = every[np.isfinite(every)].astype(np.float32)
    node = helper.make_node("HardSigmoid", ["d"], ["mask"], name="mask", alpha=1e30, beta=-1.0)
    infos = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["N"]) for name in ("d", "mask")]
    graph = helper.make_graph([node], "g", infos[:1], infos[1:])
    lowered = half_precision(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8))
    import onnxruntime

    session = onnxruntime.InferenceSession(lowered.SerializeToString(), providers=["CPUExecutionProvider"])
    (found,) = session.run(None, {"d": values})
    np.testing.assert_array_equal(found, (values > 0).astype(np.float32))


def test_bfloat16_weights_are_rounded_to_nearest_even(vgg) -> None:
    """Against torch's bfloat16; ties drawn on purpose; and half the bytes."""
    import torch

    rng = np.random.default_rng(0)
    bits = rng.integers(0x3F000000, 0x40FFFFFF, 4096, dtype=np.uint32)
    bits[::2] = bits[::2] & 0xFFFF0000 | 0x8000  # halfway between two
    values = bits.view(np.float32) * rng.choice([-1, 1], 4096).astype(np.float32)
    tensors = [numpy_helper.from_array(values, "w"), numpy_helper.from_array(values[: MANY - 1], "few")]
    nodes = [helper.make_node("Identity", [name], [f"{name}_out"], name=name) for name in ("w", "few")]
    infos = [helper.make_tensor_value_info(f"{n}_out", TensorProto.FLOAT, None) for n in ("w", "few")]
    model = helper.make_model(helper.make_graph(nodes, "g", [], infos, tensors), ir_version=8,
                              opset_imports=[helper.make_opsetid("", 17)])  # fmt: skip
    stored = {t.name: t for t in bfloat16_weights(model).graph.initializer}
    assert set(stored) == {"w/bf16", "few"}
    assert stored["w/bf16"].data_type == TensorProto.BFLOAT16
    found = (np.frombuffer(stored["w/bf16"].raw_data, np.uint16).astype(np.uint32) << 16).view(np.float32)
    np.testing.assert_array_equal(found, torch.tensor(values).to(torch.bfloat16).to(torch.float32).numpy())

    lowered = bfloat16_weights(vgg.model)
    onnx.checker.check_model(lowered, full_check=True)
    assert lowered.ByteSize() < 0.52 * vgg.model.ByteSize()


# -- what is said, and refused -------------------------------------------------------------------------------------


def test_the_report() -> None:
    found = lower_precision.PrecisionCheck("int8", 0.97, 0.88, 490.0, 500.0, 71.0, 71.5, 47.9, 48.0, 0.35)
    lines = found.table().splitlines()
    assert lines[1].split() == ["fp32", "1", "100%", "500", "71.5", "48.0", "1"]
    assert lines[2].split() == ["int8", "0.9700", "88.0%", "490", "71.0", "47.9", "0.35"]
    assert len(lines) == 3
    assert found.figures()["lower_correlation"] == 0.97
    assert "lower_time" not in found.figures()  # another machine would write another file

    slow = lower_precision.PrecisionCheck("int8", 0.97, 0.88, 490.0, 500.0, 71.0, 71.5, None, None, 1.2)
    assert slow.table().splitlines()[-1].startswith("int8 is no faster here")
    assert "no faster" not in replace(slow, precision="bf16").table()
    assert replace(slow, precision="bf16").table().splitlines()[2].split()[-2:] == ["-", "1.20"]


def test_a_model_agrees_with_itself(tmp_path: Path, pictures: Path) -> None:
    onnx.save(small.nchw(("n", 3, "h", "w")), tmp_path / "model.onnx")
    path = export_onnx(tmp_path / "model.onnx", "relu2", ["relu2"], tmp_path / "elf.onnx").path
    found = lower_precision.measure(path.read_bytes(), path.read_bytes(), calibration_set(pictures))
    assert found.correlation == pytest.approx(1)
    assert (found.agreeing, found.keypoints, found.rep, found.ms) == (
        1.0, found.keypoints_fp32, found.rep_fp32, found.ms_fp32
    )  # fmt: skip
    assert found.rep > 30


@pytest.fixture(scope="module")
def small_elf(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    folder = tmp_path_factory.mktemp("small")
    onnx.save(small.nchw(("n", 3, "h", "w")), folder / "model.onnx")
    return export_onnx(folder / "model.onnx", "relu2", ["relu2"], folder / "elf.onnx").path.read_bytes()


def test_panoramas_and_images_below_the_smallest_size_are_compared(tmp_path: Path, small_elf: bytes) -> None:
    cv2.imwrite(str(tmp_path / "panorama.png"), textured(40, 5000))
    cv2.imwrite(str(tmp_path / "small.png"), textured(31, 40))
    images, spec = calibration_set(tmp_path), InputSpec(min_size=32)
    assert [image.shape[:2] for image in lower_precision._sources(images, spec, 1.0)] == [(32, 640), (32, 41)]
    assert lower_precision.measure(small_elf, small_elf, images).correlation == pytest.approx(1)


def test_bit_depths_are_compared_as_the_runtime_reads_them(tmp_path: Path, small_elf: bytes) -> None:
    """8 bits, 12 of 16 bits, and float: the same picture, the same figures but for the rounding of its view."""
    image = textured(300, 400)
    image[0, 0] = 255
    figures = []
    depths = {"8.png": image, "12.png": image.astype(np.uint16) * 16, "float.tif": np.float32(image) / 255}
    for name, pixels in depths.items():
        folder = tmp_path / name
        folder.mkdir()
        cv2.imwrite(str(folder / name), pixels)
        figures.append(lower_precision.measure(small_elf, small_elf, calibration_set(folder)))
    eight, *others = figures
    assert eight.keypoints > 50
    for found in others:
        assert found.keypoints == pytest.approx(eight.keypoints, rel=0.05)
        assert found.rep == pytest.approx(eight.rep, abs=5)


def test_an_enlarged_float_image_stays_within_its_range(tmp_path: Path, small_elf: bytes) -> None:
    pixels = np.zeros((16, 20), np.float32)
    pixels[4:9, 5:12] = 1
    cv2.imwrite(str(tmp_path / "f.tif"), pixels)
    assert lower_precision.measure(small_elf, small_elf, calibration_set(tmp_path)).correlation == pytest.approx(1)


def test_a_flat_image_does_not_count(tmp_path: Path, small_elf: bytes) -> None:
    def measured() -> lower_precision.PrecisionCheck:
        return replace(lower_precision.measure(small_elf, small_elf, calibration_set(tmp_path)), time=0)

    cv2.imwrite(str(tmp_path / "a.png"), textured(120, 160))
    alone = measured()
    cv2.imwrite(str(tmp_path / "b.png"), np.zeros((120, 160, 3), np.uint8))
    assert measured() == alone


def test_what_has_no_saliency_compares_nothing(tmp_path: Path, small_elf: bytes) -> None:
    """A panorama whose central part, which is taken, is flat."""
    image = textured(32, 3000)
    image[:, 1000:2000] = 7
    cv2.imwrite(str(tmp_path / "a.png"), image)
    with pytest.raises(ExportError, match=f"1 images of {tmp_path.name}: float32 finds no saliency in any"):
        lower_precision.measure(small_elf, small_elf, calibration_set(tmp_path))


def test_a_lost_saliency_is_refused(tmp_path: Path, pictures: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from elf_export.precision import lower as precision

    def drowned(model: onnx.ModelProto) -> onnx.ModelProto:
        lowered = bfloat16_weights(model)
        for tensor in lowered.graph.initializer:
            if tensor.data_type == TensorProto.BFLOAT16:
                noise = np.random.default_rng(0).standard_normal(tuple(tensor.dims)).astype(np.float32)
                halves = (noise.view(np.uint32) >> 16).astype(np.uint16)
                tensor.raw_data = halves.tobytes()
        return lowered

    monkeypatch.setattr(precision, "bfloat16_weights", drowned)
    monkeypatch.setattr(lower_precision, "LEAST_CORRELATION", 0.98)
    with pytest.raises(ExportError, match=r"bf16 loses the saliency of this network.*No file was written"):
        export_network("vgg", "pool2", [], tmp_path / "a.onnx", offline=True, precision="bf16", calibration=pictures)
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("small_probes")
@pytest.mark.parametrize("precision", ["int8", "fp16", "bf16"])
def test_old_opsets_are_refused(tmp_path: Path, precision: str, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--net", "vgg", "--layer", "conv1_1", "--desc", "none", "--offline", "--opset", "12"]
    assert main([*arguments, "--precision", precision, "-o", str(tmp_path / "a.onnx")]) == 1
    assert f"{precision} needs opset 13 or later; choose one with --opset" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_precision_that_there_is_none_of_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="precision is one of fp32, fp16, bf16, int8, not 'int4'"):
        export_network("vgg", "conv1_1", [], tmp_path / "a.onnx", offline=True, precision="int4")


def test_what_can_be_refused_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("elf_export.sources.named.load_weights", lambda *_: pytest.fail("weights were loaded before"))
    monkeypatch.setattr(
        "elf_export.sources.foreign.detector.prepare", lambda *_: pytest.fail("the model was prepared before")
    )
    for opset in (11, 17):
        onnx.save(small.nchw(opset=opset), tmp_path / f"{opset}.onnx")
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "broken.png").write_bytes(b"no image")
    net = ["--net", "vgg", "--offline", "-o", str(tmp_path / "a.onnx")]
    old, new = (["--onnx", str(tmp_path / f"{n}.onnx"), "--layer", "relu2", "--desc", "none"] for n in (11, 17))
    for words, message in (
        ([*net, "--opset", "11"], "the model is of opset 11, int8 needs opset 13 or later; choose one with --opset"),
        ([*old, "--opset", "11"], "the model is of opset 11, int8 needs opset 13 or later"),
        ([*new, "--opset", "12"], "the model is of opset 12, int8 needs opset 13 or later"),
        ([*net, "--calibration", str(tmp_path / "pictures")], "broken.png: not an image that OpenCV can decode"),
        ([*new, "--calibration", str(tmp_path / "pictures")], "broken.png: not an image that OpenCV can decode"),
    ):
        assert main([*words, "--precision", "int8"]) == 1
        assert message in capsys.readouterr().err


def test_a_model_of_an_older_opset_is_converted_to_what_the_precision_needs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    onnx.save(small.nchw(opset=11), tmp_path / "old.onnx")
    words = ["--onnx", str(tmp_path / "old.onnx"), "--layer", "relu2", "--desc", "none", "-o", str(tmp_path / "a.onnx")]
    assert main([*words, "--precision", "bf16"]) == 0
    assert "the model is of opset 11 and was converted to 13" in capsys.readouterr().out
    assert opset_of(onnx.load(tmp_path / "a.onnx")) == 13


@pytest.mark.usefixtures("small_probes")
def test_calibration_folders_that_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = ["--net", "vgg", "--layer", "conv1_2", "--desc", "none", "--offline", "-o", str(tmp_path / "a.onnx")]
    with pytest.raises(SystemExit):
        main([*base, "--calibration", str(tmp_path)])
    assert "--calibration goes with --desc-dim or --precision only" in capsys.readouterr().err
    for folder, message in ((tmp_path / "nowhere", "not a folder of calibration images"), (tmp_path, "no image to")):
        assert main([*base, "--precision", "int8", "--calibration", str(folder)]) == 1
        assert message in capsys.readouterr().err
    (tmp_path / "broken.png").write_bytes(b"no image")
    assert main([*base, "--precision", "int8", "--calibration", str(tmp_path)]) == 1
    assert "broken.png: not an image that OpenCV can decode" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["broken.png"]


@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        ("scale=0.5", "scale", 0.5),
        ("nms_radius=6", "nms_radius", 6),
        ("denoise=5,1.2", "denoise", (5, 1.2)),
        (" denoise = 5 , 1.2 ", "denoise", (5, 1.2)),
        ("subpixel=true", "subpixel", True),
        ("subpixel=False", "subpixel", False),
        ("threshold=kapur", "threshold", "kapur"),
    ],
)
def test_settings_are_read(text: str, name: str, value: object) -> None:
    assert setting(text) == (name, value)
    assert type(setting(text)[1]) is type(value)


@pytest.mark.parametrize("text", ["scale", "=1", "scale=", "denoise=5,", ""])
def test_settings_that_are_none(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parser().parse_args(["--net", "vgg", "--set", text])
    assert f"{text!r} is not NAME=VALUE" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sale=1", "unknown detection setting 'sale'; known are"),
        ("scale=9", r"scale is a number in (0, 8], not 9"),
        ("scale=large", r"scale is a number in (0, 8], not 'large'"),
        ("denoise=4,1", "denoise is (mu, sigma) with mu odd"),
        ("subpixel=1", "subpixel is True or False, not 1"),
    ],
)
def test_settings_out_of_range(tmp_path: Path, text: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Before anything is computed."""
    assert main(["--net", "vgg", "--offline", "--set", text, "-o", str(tmp_path / "a.onnx")]) == 1
    assert message in capsys.readouterr().err


def setting_words(settings: dict[str, object]) -> list[str]:
    program, *words = Request(net="vgg", detection=settings).words()
    assert (program, words[:2]) == ("elf-export", ["--net", "vgg"])
    return words[2:]


def test_settings_become_the_options_that_say_them() -> None:
    own = get_network("vgg").detection
    for changes in ({}, {"scale": 0.33}, {"denoise": (7, 1.8), "subpixel": True}, {"threshold": 0.25, "border": 0}):
        wanted = own.updated(**changes)
        words = setting_words(changed(own, wanted))
        assert len(words) == 2 * len(changes)
        args = parser().parse_args(["--net", "vgg", *words])
        assert own.updated(**dict(args.set)) == wanted
    assert isinstance(own, DetectionParams)


def test_options_say_what_differs_from_the_network_s_own_settings_to_the_last_digit() -> None:
    own = DetectionParams(denoise=(9, 3.0), border=4)
    assert setting_words(changed(own, own)) == []
    assert setting_words(changed(own, own.updated(border=10, subpixel=True))) == [
        "--set",
        "border=10",
        "--set",
        "subpixel=true",
    ]
    wanted = own.updated(scale=1 / 3, denoise=(7, 1.8000001), threshold=0.1 + 0.2)
    args = parser().parse_args(["--net", "vgg", *setting_words(changed(own, wanted))])
    assert own.updated(**dict(args.set)) == wanted


def test_settings_are_all_or_changes_to_the_network_s_own() -> None:
    own = DetectionParams(denoise=(9, 3.0), border=4)
    assert chosen(own, None) == chosen(own, {}) == own
    assert chosen(own, {"scale": 0.5}) == DetectionParams(denoise=(9, 3.0), border=4, scale=0.5)
    assert chosen(own, DetectionParams(scale=0.5)) == DetectionParams(scale=0.5)
    with pytest.raises(ExportError, match="border is an integer >= 0, not -1"):
        chosen(own, {"border": -1})
