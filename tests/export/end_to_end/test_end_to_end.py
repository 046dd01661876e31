"""Keypoints out of the file alone against `ElfRuntime.detect`, and what can't be in such a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

onnx = pytest.importorskip("onnx")

import onnxruntime as ort  # noqa: E402

from elf_export.checks.alone import compare_alone  # noqa: E402
from elf_export.cli import main  # noqa: E402
from elf_export.end_to_end.build import Form, end_to_end  # noqa: E402
from elf_export.errors import ExportError  # noqa: E402
from elf_export.pipeline import export  # noqa: E402
from elf_export.request import Request  # noqa: E402
from elf_runtime import ElfRuntime, Features  # noqa: E402
from elf_runtime.image.file import read  # noqa: E402
from elf_runtime.model import bundled_model  # noqa: E402
from helpers import ROOT, TINY, textured  # noqa: E402

from .running import QUIET  # noqa: E402

pytestmark = pytest.mark.torch


def corner() -> np.ndarray:
    image = np.full((120, 150, 3), 60, np.uint8)
    image[60:, 75:] = 200
    return image


RNG = np.random.default_rng(0)
IMAGES = {
    "photograph": read(ROOT / "demo" / "palace.jpg"),
    "textured": textured(150, 201),
    "grey": textured(90, 131, channels=1).reshape(90, 131, 1),
    "noise": RNG.integers(0, 256, (111, 140, 3), np.uint8),
    "flat": np.full((64, 64, 3), 90, np.uint8),
    "one corner": corner(),
    "plateaus": np.kron(RNG.integers(0, 2, (9, 11, 1)).astype(np.uint8) * 200, np.ones((16, 16, 3), np.uint8)),
    "tiny": textured(33, 47),
    "thin": textured(34, 400),
}


BYTES = Form()


def session(model: Path, form: Form = BYTES, **settings: object) -> tuple[ElfRuntime, ort.InferenceSession, dict]:
    """The runtime, the file alone, and the settings that it has."""
    elf = ElfRuntime(model)
    contract = replace(elf.contract, detection=elf.contract.detection.updated(**settings))
    graph = end_to_end(onnx.load(model), contract, form)
    return elf, ort.InferenceSession(graph.SerializeToString(), QUIET), {"params": contract.detection}


def assert_same(wanted: Features, keypoints: np.ndarray, scores: np.ndarray, descriptors: np.ndarray) -> None:
    assert keypoints.shape == (len(wanted), 2)
    np.testing.assert_allclose(keypoints, wanted.keypoints, atol=0.01)
    np.testing.assert_allclose(scores, wanted.scores, rtol=1e-4, atol=1e-3)
    assert descriptors.shape == wanted.descriptors.shape
    described = wanted.descriptors.any(axis=1)  # a place where the whole map is 0 has none
    assert (descriptors.any(axis=1) == described).all()
    assert ((descriptors * wanted.descriptors).sum(axis=1)[described] > 0.999).all()


SETTINGS = [
    {},
    {"normalize": 0.95, "suppression": "maxima", "subpixel": True, "denoise": (3, 0.8), "nms_radius": 4},
    {"scale": 0.45, "subpixel": True, "min_contrast": 3.0},
    {"quantize": True, "threshold": "none", "border": 0, "nms_radius": 0},
    {"threshold": 0.3, "max_keypoints": 5, "mask_border": 0},
]


@pytest.mark.parametrize("settings", SETTINGS, ids=range(len(SETTINGS)))
def test_the_file_alone_finds_what_the_runtime_finds(settings: dict[str, object]) -> None:
    elf, alone, params = session(TINY, **settings)
    found = 0
    for image in IMAGES.values():
        for masked in (False, True):
            mask = np.zeros(image.shape[:2], np.uint8)
            mask[image.shape[0] // 4 :, : 2 * image.shape[1] // 3] = 1
            feed = {"image": image[None]} | ({"mask": mask} if masked else {})
            wanted = elf.detect(image, mask=mask if masked else None, **params)
            assert_same(wanted, *alone.run(None, feed))
            found += len(wanted)
    assert found > 30


@pytest.mark.parametrize("precision", ["int8", "fp32"])
def test_the_bundled_models_alone(precision: str) -> None:
    elf, alone, params = session(bundled_model(precision))
    for name in ("photograph", "textured", "noise", "tiny"):
        wanted = elf.detect(IMAGES[name], **params)
        assert_same(wanted, *alone.run(None, {"image": IMAGES[name][None]}))


def test_straight_edges_have_the_runtime_s_keypoints() -> None:
    """In fp32 places along an edge differ in the last bits, and not the same ones here and there."""
    elf, alone, params = session(bundled_model("fp32"))
    found = near = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        image = np.full((*rng.integers(120, 400, 2), 3), rng.integers(0, 256, 3), np.uint8)
        image[rng.integers(40, 80) :, rng.integers(40, 80) :] = rng.integers(0, 256, 3)
        wanted, there = elf.detect(image, **params).keypoints, alone.run(None, {"image": image[None]})[0]
        assert len(there) == len(wanted)
        found += len(wanted)
        near += (np.abs(wanted[:, None] - there[None]).max(axis=2).min(axis=1) <= 0.01).sum()
    assert found > 200
    assert near >= 0.995 * found


def test_inputs_that_have_defaults() -> None:
    elf, alone, params = session(TINY, threshold="none", max_keypoints=40)
    image = IMAGES["textured"]
    for most, threshold in ((0, 0.0), (7, 0.5), (10_000, -1.0)):
        feed = {"image": image[None], "max_keypoints": np.array(most), "threshold": np.array(threshold, np.float32)}
        level = "kapur" if threshold < 0 else threshold
        changed = params["params"].updated(max_keypoints=most, threshold=level)
        assert_same(elf.detect(image, params=changed), *alone.run(None, feed))


def test_inputs_that_must_be_given() -> None:
    elf, alone, params = session(TINY, Form(required=True), max_keypoints=40)
    image, mask = IMAGES["textured"], np.zeros((150, 201), np.uint8)
    mask[30:, :150] = 1
    with pytest.raises(ValueError, match="max_keypoints"):
        alone.run(None, {"image": image[None]})
    assert "--end-to-end required" in " ".join(Form(required=True).words())
    for most, threshold, its in ((40, -1.0, np.ones((1, 1), np.uint8)), (7, 0.3, mask)):
        level, wanted = "kapur" if threshold < 0 else threshold, mask if its is mask else None
        feed = {"max_keypoints": np.array(most), "threshold": np.array(threshold, np.float32), "mask": its}
        changed = params["params"].updated(max_keypoints=most, threshold=level)
        found = alone.run(None, {"image": image[None], **feed})
        assert_same(elf.detect(image, params=changed, mask=wanted), *found)


def test_a_batch_is_padded() -> None:
    elf, alone, params = session(TINY, Form("float32", batch=True), max_keypoints=60)
    images = np.stack([textured(80, 100, 0), np.full((80, 100, 3), 7, np.uint8), textured(80, 100, 1)])
    names = ("keypoints", "scores", "counts", "descriptors")
    found = dict(zip(names, alone.run(names, {"image": images.astype(np.float32)}), strict=True))
    assert found["keypoints"].shape == (3, 60, 2)
    assert found["counts"][1] == 0
    for i, count in enumerate(found["counts"]):
        parts = [found[name][i] for name in ("keypoints", "scores", "descriptors")]
        assert_same(elf.detect(images[i], **params), *(part[:count] for part in parts))
        assert not any(part[count:].any() for part in parts)
    for most in (0, 2):
        feed = {"image": images.astype(np.float32), "max_keypoints": np.array(most)}
        few = dict(zip(names, alone.run(names, feed), strict=True))
        assert few["keypoints"].shape == (3, most, 2)
        assert few["counts"].tolist() == [most, 0, most]
        np.testing.assert_array_equal(few["descriptors"][0], found["descriptors"][0, :most])


def test_channels_in_the_other_order() -> None:
    elf, alone, params = session(TINY, Form(color="rgb"))
    image = IMAGES["photograph"]
    wanted = elf.detect(image, **params)
    assert_same(wanted, *alone.run(None, {"image": image[None, :, :, ::-1]}))
    other = alone.run(None, {"image": image[None]})[0]
    assert other.shape != wanted.keypoints.shape or np.abs(other - wanted.keypoints).max() > 1


def test_rounds_without_control_flow() -> None:
    elf, alone, params = session(TINY, Form(rounds=12))
    graph = end_to_end(onnx.load(TINY), elf.contract, Form(rounds=3))
    assert not {"Loop", "If", "Scan"} & {node.op_type for node in graph.graph.node}
    image = IMAGES["textured"]
    assert_same(elf.detect(image, **params), *alone.run(None, {"image": image[None]}))


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"scales": (0.5, 1.0)}, "the setting scales"),
        ({"oriented": True}, "the setting oriented"),
        ({"grid": (2, 2)}, "the setting grid"),
        ({"max_side": 100, "grid": (2, 2)}, "the setting grid, nor the setting max_side"),
    ],
)
def test_what_can_t_be_in_a_graph(settings: dict[str, object], reason: str) -> None:
    with pytest.raises(ExportError, match=f"a graph can't hold {reason}"):
        session(TINY, **settings)


def test_what_can_t_is_said_before_anything_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from export.small_models import nchw

    monkeypatch.setattr("elf_export.pipeline.finished_graph", lambda *_: pytest.fail("work was done"))
    onnx.save(nchw(("N", 3, "H", "W")), tmp_path / "net.onnx")
    file, output = tmp_path / "net.onnx", tmp_path / "e.onnx"
    wanted = Request(onnx=file, layer="relu1", desc=(), output=output, detection={"grid": (2, 2)}, end_to_end=Form())
    with pytest.raises(ExportError, match="a graph can't hold the setting grid"):
        export(wanted)


def test_a_form_that_is_none() -> None:
    with pytest.raises(ExportError, match="pixels are uint8 or float32, not 'int8'"):
        Form("int8")
    with pytest.raises(ExportError, match="-1 rounds"):
        Form(rounds=-1)


def test_a_graph_that_finds_something_else_is_not_written() -> None:
    elf = ElfRuntime(TINY)
    other = replace(elf.contract, detection=elf.contract.detection.updated(nms_radius=3, denoise=(9, 3.0)))
    from elf_export.calibration import calibration_set

    images = calibration_set(None)
    right = compare_alone(end_to_end(onnx.load(TINY), elf.contract), TINY.read_bytes(), Form(), images)
    assert right.passed
    assert (right.near, right.counts) == (1.0, 1.0)
    wrong = compare_alone(end_to_end(onnx.load(TINY), other), TINY.read_bytes(), Form(), images)
    assert not wrong.passed
    assert "are not the runtime's" in wrong.complaint
    assert "--rounds" not in wrong.complaint
    few = Form(rounds=1)
    unrolled = compare_alone(end_to_end(onnx.load(TINY), elf.contract, few), TINY.read_bytes(), few, images)
    assert not unrolled.passed
    assert "1 rounds may be too few: more by --rounds" in unrolled.complaint


def test_the_command_makes_a_file_that_says_what_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], small_probes: None, one_direction: None
) -> None:
    from export.small_models import nchw

    onnx.save(nchw(("N", 3, "H", "W")), tmp_path / "net.onnx")
    words = [
        "--onnx",
        str(tmp_path / "net.onnx"),
        "--layer",
        "relu1",
        "--desc",
        "relu2",
        "-o",
        str(tmp_path / "e.onnx"),
    ]
    assert main([*words, "--end-to-end", "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    metadata = {prop.key: prop.value for prop in onnx.load(tmp_path / "e.onnx").metadata_props}
    assert (
        metadata["elf.end_to_end"]
        == '{"batch": false, "color": "bgr", "opencv": false, "pixels": "uint8", "required": false, "rounds": 0, '
        '"saliency": false}'
    )
    assert "--end-to-end" in metadata["elf.command"]
    found = ort.InferenceSession(tmp_path / "e.onnx", QUIET).run(None, {"image": IMAGES["textured"][None]})
    assert len(found[0]) > 10
    assert_same(ElfRuntime(tmp_path / "e.onnx").detect(IMAGES["textured"]), *found)
    with pytest.raises(SystemExit):
        main([*words, "--rounds", "3"])
    assert "--rounds goes with --end-to-end only" in capsys.readouterr().err


def test_the_form_for_opencv_has_the_same_values() -> None:
    """A padded convolution of 1x1 is what the adjoint of a 3x3 one behind a 2x2 pool has."""
    contract, image = ElfRuntime(bundled_model("fp32")).contract, IMAGES["textured"]
    found, padded = [], []
    for opencv in (False, True):
        graph = end_to_end(onnx.load(bundled_model("fp32")), contract, Form(saliency=True, opencv=opencv))
        kernels = {x.name: tuple(x.dims)[2:] for x in graph.graph.initializer}
        convs = [node for node in graph.graph.node if node.op_type == "Conv" and kernels.get(node.input[1]) == (1, 1)]
        stated = [{a.name: list(a.ints) for a in node.attribute} for node in convs]
        padded.append(sum(any(one["pads"]) and one["strides"] == [1, 1] for one in stated))
        found.append(ort.InferenceSession(graph.SerializeToString(), QUIET).run(None, {"image": image[None]}))
    assert padded[0] > 0
    assert padded[1] == 0
    for wanted, there in zip(*found, strict=True):
        np.testing.assert_allclose(there, wanted, atol=1e-3 * np.abs(wanted).max())
