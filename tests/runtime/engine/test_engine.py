"""ElfRuntime on a small model: every kind of input and setting, and the defined empty result."""

from __future__ import annotations

import inspect
import re
import shutil
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime import (
    ContractError,
    DetectionParams,
    ElfError,
    ElfRuntime,
    Features,
    ImageError,
    InputSpec,
    ModelContract,
    ModelError,
    ProviderError,
    SettingError,
    match,
    preset,
)
from elf_runtime.detection.refine import parabola_peaks
from elf_runtime.detection.working_image import prepare
from elf_runtime.model.onnx_file import read_onnx
from helpers import TINY, textured


@pytest.fixture(scope="module")
def elf() -> ElfRuntime:
    return ElfRuntime(TINY, threads=1)


def same(a: Features, b: Features, tolerance: float = 0.0) -> bool:
    close = [(a.keypoints, b.keypoints), (a.scores, b.scores), (a.descriptors, b.descriptors)]
    return len(a) == len(b) and all(np.allclose(x, y, rtol=0, atol=tolerance) for x, y in close)


def test_what_comes_out(elf: ElfRuntime, image: np.ndarray) -> None:
    f = elf.detect(image)
    n = len(f)
    assert n >= 5
    assert (f.keypoints.shape, f.scores.shape, f.descriptors.shape) == ((n, 2), (n,), (n, 8))
    assert {a.dtype for a in (f.keypoints, f.scores, f.descriptors)} == {np.dtype(np.float32)}
    assert (np.diff(f.scores) <= 0).all()
    norms = np.linalg.norm(f.descriptors, axis=1)
    assert np.allclose(norms[norms > 0], 1, atol=1e-5)
    assert f.image_size == (120, 160)
    assert (f.keypoints >= 10).all()
    assert (f.keypoints < [150, 110]).all()


@pytest.mark.parametrize("size", [(32, 32), (33, 47), (479, 641), (32, 200), (101, 64)])
def test_any_size(elf: ElfRuntime, size: tuple[int, int]) -> None:
    image = textured(*size, seed=3)
    assert elf.saliency(image).shape == size
    elf.detect(image, border=2)
    elf.detect(image, scale=0.5)
    assert elf.saliency(image, scale=0.7).shape == size


def test_the_saliency_s_scale_is_the_one_asked_for(elf: ElfRuntime, image: np.ndarray) -> None:
    height, width = image.shape[:2]
    small = elf.trace(image, scale=0.5).saliency
    wanted = cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)
    np.testing.assert_array_equal(elf.saliency(image, scale=0.5), wanted)


def test_all_kinds_of_images_give_the_same(elf: ElfRuntime, image: np.ndarray, tmp_path: Path) -> None:
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    wanted = elf.detect(grey)
    assert same(elf.detect(grey[:, :, None]), wanted)
    assert same(elf.detect(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)), wanted)
    assert same(elf.detect(grey.astype(np.uint16) * 257), wanted, 1e-2)
    assert same(elf.detect(grey / 255.0), wanted, 1e-2)
    cv2.imwrite(str(tmp_path / "grey.png"), grey)
    assert same(elf.detect(tmp_path / "grey.png"), wanted)
    assert same(elf.detect(str(tmp_path / "grey.png")), wanted)


def test_a_lone_corner_is_found_where_it_is(elf: ElfRuntime) -> None:
    """A half-pixel shift or swapped axes would be seen here: a dot is its own keypoint, at any working scale."""
    image = np.full((100, 140, 3), 60, np.uint8)
    image[61:64, 87:90] = 255
    for scale in (1.0, 2.0):
        f = elf.detect(image, scale=scale, max_keypoints=1)
        assert np.abs(f.keypoints[0] - [88, 62]).max() <= 1.5
        assert np.abs(elf.saliency(image, scale=scale)).max() > 0


def test_limits_and_masks(elf: ElfRuntime, image: np.ndarray) -> None:
    every = elf.detect(image)
    assert np.array_equal(elf.detect(image, max_keypoints=5).keypoints, every.keypoints[:5])
    assert len(elf.detect(image, max_keypoints=0)) == 0
    mask = np.zeros(image.shape[:2], np.uint8)
    mask[30:90, 40:120] = 1
    inside = elf.detect(image, mask=mask).keypoints
    assert len(inside)
    assert (inside >= [40, 30]).all()
    assert (inside < [120, 90]).all()
    nothing = elf.detect(image, mask=np.zeros_like(mask))
    assert (nothing.keypoints.shape, nothing.scores.shape, nothing.descriptors.shape) == ((0, 2), (0,), (0, 8))
    wide = elf.detect(image, border=40).keypoints
    assert (wide >= 40).all()
    height, width = image.shape[:2]
    assert (wide < [width - 40, height - 40]).all()
    for all_of_it in ((min(height, width) + 1) // 2, 10 * width):
        assert len(elf.detect(image, border=all_of_it)) == 0
    far = elf.detect(image, nms_radius=25).keypoints
    gaps = np.abs(far[:, None] - far[None]).max(2) + 1e9 * np.eye(len(far))
    assert gaps.min() > 25


@pytest.mark.parametrize("quantize", [False, True])
def test_scores_are_floats_at_the_keypoints(elf: ElfRuntime, image: np.ndarray, quantize: bool) -> None:
    traced = elf.trace(image, quantize=quantize, scale=1.0, border=7, subpixel=False)
    assert traced.scores.dtype == traced.features.scores.dtype == np.float32
    x, y = traced.features.keypoints.astype(int).T
    assert len(x)
    np.testing.assert_array_equal(traced.features.scores, traced.scores[y, x])
    assert traced.mask[y, x].all()


@pytest.mark.parametrize("border", [1, 5, 10, 15, 50])
@pytest.mark.parametrize("scale", [0.28, 0.45, 0.5, 1.0, 1.7])
def test_no_keypoint_within_the_border(elf: ElfRuntime, border: int, scale: float) -> None:
    image = textured(157, 211)
    for subpixel in (False, True):
        settings = {"scale": scale, "subpixel": subpixel, "threshold": "none", "nms_radius": 1, "denoise": (1, 1.0)}
        points = elf.detect(image, border=border, max_keypoints=100_000, **settings).keypoints
        assert len(points) > 20
        assert (points >= border).all()
        assert (points <= np.array([211, 157]) - 1 - border).all()
        # Not a working pixel more than that is left out.
        assert (points.min(axis=0) < border + 2 / scale + 1).all()


@pytest.mark.parametrize("scale", [0.28, 0.45, 0.5, 1.0, 1.7])
@pytest.mark.parametrize("subpixel", [False, True])
def test_keypoints_round_to_pixels_of_the_mask(elf: ElfRuntime, scale: float, subpixel: bool) -> None:
    image = textured(157, 211)
    mask = np.random.default_rng(0).random((20, 27)) < 0.5
    mask = np.kron(mask, np.ones((8, 8), bool))[:157, :211]
    settings = {"scale": scale, "subpixel": subpixel, "threshold": "none", "nms_radius": 1, "denoise": (1, 1.0)}
    points = elf.detect(image, mask=mask, border=0, mask_border=0, max_keypoints=100_000, **settings).keypoints
    assert len(points) > 50
    x, y = np.rint(points).astype(int).T
    assert mask[y, x].all()


def test_a_border_of_more_rows_than_columns(elf: ElfRuntime) -> None:
    """Rounded to whole working pixels, the border can differ between rows and columns."""
    image, settings = textured(101, 140), {"scale": 0.52, "border": 10, "nms_radius": 2}
    work = elf._prepare(image, elf.params(**settings), None)
    rows, columns = work.scaling.margin(10)
    assert rows != columns
    found = elf.trace(image, **settings)
    assert len(found.features) > 5
    x, y = np.rint(work.scaling.to_working(found.features.keypoints)).astype(int).T
    np.testing.assert_array_equal(found.scores[y, x], found.features.scores)


def test_a_refined_point_at_the_border_stays(elf: ElfRuntime) -> None:
    work = elf._prepare(textured(60, 80), elf.params(scale=1.0), None)
    refined = np.array([[10.0, 20.25], [69.0, 49.0], [9.75, 20.25]], np.float32)
    found = np.array([[10, 20], [69, 49], [10, 20]])
    np.testing.assert_array_equal(work.kept_inside(refined, found, 10), [[10.0, 20.25], [69.0, 49.0], [10.0, 20.0]])


def test_a_radius_is_at_least_a_working_pixel_where_above_zero(elf: ElfRuntime) -> None:
    work = elf._prepare(textured(160, 200), elf.params(scale=0.25), None)
    assert [work.scaling.radius(r) for r in (0, 1, 4, 6, 10_000)] == [0, 1, 1, 2, 50]


def test_the_radius_of_a_model_of_one_size_is_in_source_pixels() -> None:
    contract = ModelContract("net", "layer", 2.0, input=InputSpec(height=60, width=80))
    work = prepare(textured(120, 160), DetectionParams(), None, contract, "m.onnx")
    assert work.scaling.scale == 0.5
    assert work.scaling.radius(10) == 5


def test_without_border_and_mask_every_place_is_refined(elf: ElfRuntime, image: np.ndarray) -> None:
    settings = {"scale": 0.45, "border": 0, "threshold": "none"}
    traced = elf.trace(image, subpixel=True, **settings)
    whole = elf.trace(image, subpixel=False, **settings).features.keypoints
    size, working = np.array([160, 120]), np.array(traced.scores.shape[::-1])
    found = np.rint((whole + 0.5) * working / size - 0.5).astype(np.int64)
    refined = (parabola_peaks(traced.scores, found) + 0.5) * size / working - 0.5
    np.testing.assert_allclose(traced.features.keypoints, refined, atol=1e-3)
    assert (traced.features.keypoints != whole).any()


def test_lengths_beyond_the_image_are_the_image(elf: ElfRuntime, image: np.ndarray) -> None:
    one = elf.detect(image, nms_radius=160, border=0)
    assert len(one) == 1
    for length in (3000, 10**20, 10**400):
        found = elf.detect(image, nms_radius=length, border=0)
        np.testing.assert_array_equal(found.keypoints, one.keypoints)
        assert len(elf.detect(image, border=length, subpixel=True)) == 0


def test_a_flat_image_is_the_empty_result(elf: ElfRuntime) -> None:
    for value in (0, 128, 255, (200, 100, 50)):
        flat = np.full((64, 64, 3), value, np.uint8)
        f = elf.detect(flat)
        assert (f.keypoints.shape, f.scores.shape, f.descriptors.shape) == ((0, 2), (0,), (0, 8))
        assert not elf.saliency(flat).any()
        assert elf.detect(flat, nms_radius=3).nms_radius == 3


def test_presets_change_the_settings(elf: ElfRuntime, image: np.ndarray) -> None:
    assert elf.params("paper").quantize
    assert elf.params("paper", scale=0.5).scale == 0.5
    assert elf.params("paper-robust").threshold_blur == (17, 6.0)
    elf.detect(image, preset="paper")
    with pytest.raises(SettingError, match=r"unknown preset 'fastest'.*paper"):
        elf.detect(image, preset="fastest")
    with pytest.raises(SettingError, match="unknown detection setting 'radius'"):
        elf.detect(image, radius=3)
    with pytest.raises(SettingError, match="threshold"):
        elf.detect(image, threshold="otsu")
    with pytest.raises(SettingError, match=r"unknown preset \['fast'\]"):
        elf.detect(image, preset=["fast"])  # type: ignore[arg-type]


def test_a_preset_s_scale_is_the_same_for_every_call(elf: ElfRuntime, image: np.ndarray) -> None:
    found = elf.detect(image, preset="fast")
    assert len(found) > 1
    assert np.allclose(elf.describe(image, found.keypoints, preset="fast"), found.descriptors, atol=1e-5)
    assert not np.allclose(elf.describe(image, found.keypoints), found.descriptors, atol=1e-2)
    np.testing.assert_array_equal(elf.saliency(image, preset="fast"), elf.saliency(image, scale=0.28))
    for call in (elf.saliency, lambda image, preset: elf.describe(image, [[5, 5]], preset=preset)):
        with pytest.raises(SettingError, match="unknown preset 'fastest'"):
            call(image, preset="fastest")


def test_a_preset_s_scale_is_not_for_a_model_of_one_size(monkeypatch: pytest.MonkeyPatch, image: np.ndarray) -> None:
    elf = ElfRuntime(TINY, threads=1)
    spec = replace(elf.contract.input, height=60, width=80)
    monkeypatch.setattr(elf._network, "contract", replace(elf.contract, input=spec))
    for name in ("fast", "accurate"):
        assert elf.trace(image, preset=name).saliency.shape == (60, 80)
        assert elf.params(name) == preset(name).updated(scale=1.0)
        with pytest.raises(SettingError, match=r"80x60 \(width x height\) only.*scale 0.28 can't be chosen"):
            elf.detect(image, preset=name, scale=0.28)


def test_batches_equal_single_images(elf: ElfRuntime) -> None:
    images = [textured(64, 80, s) for s in range(3)] + [textured(48, 80, 9), np.full((48, 80, 3), 5, np.uint8)]
    images += [textured(48, 80, 10)]
    masks = [None, np.ones((64, 80), bool), None, None, None, np.zeros((48, 80), bool)]
    for size in (1, 2, 4):
        batch = elf.detect_batch(images, masks=masks, batch_size=size, border=4)
        for f, image, mask in zip(batch, images, masks, strict=True):
            assert same(f, elf.detect(image, mask=mask, border=4), 1e-3)
    assert elf.detect_batch([]) == []
    for count in (0, 2.5, "3", True):
        with pytest.raises(SettingError, match="batch_size is an integer >= 1"):
            elf.detect_batch(images, batch_size=count)  # type: ignore[arg-type]
    with pytest.raises(ImageError, match="masks"):
        elf.detect_batch(images, masks=[None])
    for f, other in zip(elf.detect_batch(images, masks=iter(masks), border=4), batch, strict=True):
        assert same(f, other, 1e-3)


def test_describe_equals_detect_at_its_keypoints(elf: ElfRuntime, image: np.ndarray) -> None:
    for scale in (1.0, 0.5):
        f = elf.detect(image, scale=scale, border=5)
        assert np.allclose(elf.describe(image, f.keypoints, scale=scale), f.descriptors, atol=1e-5)
    points, descriptors = elf.detect(image).to_cv2()
    assert np.allclose(elf.describe(image, points), descriptors, atol=1e-5)
    assert elf.describe(image, np.zeros((0, 2))).shape == (0, 8)
    assert elf.describe(image, []).shape == (0, 8)
    assert np.isfinite(elf.describe(image, [[-50, 9999], [0, 0]])).all()
    assert elf.describe(image, [[5, 5]], descriptor="pool1").shape == (1, 8)


@pytest.mark.parametrize(
    "points", [[[1, 2, 3]], [1, 2], [[np.nan, 0]], [[3, np.inf]], [[-np.inf, 3]], [["a", "b"]], "abc"]
)
def test_points_that_are_none(elf: ElfRuntime, image: np.ndarray, points: object) -> None:
    with pytest.raises(ImageError):
        elf.describe(image, points)


def test_matching_an_image_with_itself(elf: ElfRuntime, image: np.ndarray) -> None:
    f = elf.detect(image)
    pairs = match(f, f)
    assert len(pairs) > 0.8 * len(f)
    assert (pairs[:, 0] == pairs[:, 1]).mean() > 0.95


def test_opencv_keypoints(elf: ElfRuntime, image: np.ndarray) -> None:
    f = elf.detect(image)
    points, descriptors = f.to_cv2()
    assert len(points) == len(f)
    assert points[0].pt == pytest.approx(tuple(f.keypoints[0]))
    assert (points[0].size, points[0].angle) == (21, -1)
    assert points[0].response == pytest.approx(f.scores[0])
    assert descriptors is f.descriptors


def test_threads_share_one_instance(elf: ElfRuntime) -> None:
    images = [textured(64, 80, s) for s in range(4)]
    wanted = [elf.detect(i) for i in images]
    wrong: list[int] = []

    def work(k: int) -> None:
        wrong.extend(k for _ in range(5) if not same(elf.detect(images[k]), wanted[k]))

    workers = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for w in workers:
        w.start()
    for w in workers:
        w.join()
    assert not wrong


def test_a_session_for_each_size_changes_nothing_and_is_bounded(image: np.ndarray) -> None:
    one, none = ElfRuntime(TINY, threads=1, sizes=2), ElfRuntime(TINY, threads=1, sizes=0)
    for k in range(5):
        part = image[: 60 + 10 * k, : 90 + k]
        assert np.allclose(one.saliency(part), none.saliency(part), rtol=0, atol=1e-4)
        assert same(one.detect(part, border=4), none.detect(part, border=4), 1e-3)
        assert len(one._network.sessions) <= 5  # two sizes for each of two sets of outputs, and all outputs
        assert len(none._network.sessions) <= 3  # all outputs, the default ones, the saliency
    for sizes in (-1, True, 1.5):
        with pytest.raises(SettingError, match="sizes"):
            ElfRuntime(TINY, sizes=sizes)  # type: ignore[arg-type]


def test_warmup_and_trace(elf: ElfRuntime, image: np.ndarray) -> None:
    elf.warmup((64, 48))
    for size in ((-10, 10), (0, 64), (64.5, 64), (64, 64, 3), 64):
        with pytest.raises(SettingError, match=r"a size is \(height, width\)"):
            elf.warmup(size)  # type: ignore[arg-type]
    with pytest.raises(ImageError, match="10x10 pixels; the smallest is 32x32"):
        elf.warmup((10, 10))
    trace = elf.trace(image)
    assert {"read", "prepare", "session", "threshold", "nms", "descriptors"} <= set(trace.seconds)
    assert trace.saliency.shape == trace.scores.shape == trace.mask.shape == (120, 160)
    assert same(trace.features, elf.detect(image))


@pytest.mark.parametrize(
    ("image", "error"),
    [
        (np.zeros((1, 1, 3), np.uint8), "1x1 pixels; the smallest is 32x32"),
        (np.zeros((31, 400), np.uint8), "smallest is 32x32"),
        (np.zeros((0, 0, 3), np.uint8), "empty"),
        (np.full((64, 64), np.nan), "NaN"),
        (np.full((64, 64, 3), np.inf, np.float32), "infinite"),
        (np.zeros((64, 64), np.int64), "not int64"),
        ("missing.png", "missing.png"),
        ("a\0b.png", r"a\\x00b.png: embedded null byte"),
    ],
)
def test_images_that_are_refused(elf: ElfRuntime, image: object, error: str) -> None:
    for call in (elf.detect, elf.saliency):
        with pytest.raises(ImageError, match=error):
            call(image)  # type: ignore[operator]


def test_what_is_wrong_is_said_of_the_image_that_it_is_wrong_with(
    elf: ElfRuntime, image: np.ndarray, tmp_path: Path
) -> None:
    small = image[:8, :8]
    cv2.imwrite(str(tmp_path / "small.png"), small)
    path = tmp_path / "small.png"
    for call in (elf.detect, elf.saliency, lambda source: elf.describe(source, [(1.0, 1.0)])):
        with pytest.raises(ImageError, match=f"^{re.escape(str(path))}: the image has 8x8 pixels"):
            call(path)
        with pytest.raises(ImageError, match=r"^the image has 8x8 pixels"):
            call(small)
    with pytest.raises(ImageError, match=r"^image 1 of the batch: the image has 8x8 pixels"):
        elf.detect_batch([image, small])
    with pytest.raises(ImageError, match=f"^{re.escape(str(path))}: the image has"):
        elf.detect_batch([image, path])


def test_a_mask_of_another_shape(elf: ElfRuntime, image: np.ndarray) -> None:
    with pytest.raises(ImageError, match=r"mask has shape \(10, 10\), the image \(120, 160\)"):
        elf.detect(image, mask=np.ones((10, 10), bool))


def test_models_that_are_refused(tmp_path: Path) -> None:
    whole = TINY.read_bytes()
    bad = {
        "truncated.onnx": whole[: len(whole) // 2],
        "text.onnx": b"this is not a model\n" * 20,
        "empty.onnx": b"",
        "noise.onnx": np.random.default_rng(0).bytes(5000),
    }
    for name, data in bad.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(ModelError, match=name):
            ElfRuntime(tmp_path / name)
    with pytest.raises(ModelError, match=r"missing\.onnx: no such file"):
        ElfRuntime(tmp_path / "missing.onnx")
    with pytest.raises(ModelError, match="not a file"):
        ElfRuntime(tmp_path)
    with pytest.raises(ModelError, match="0 bytes"):
        ElfRuntime(b"")
    with pytest.raises(ModelError, match="path or bytes"):
        ElfRuntime(7)  # type: ignore[arg-type]


def test_a_model_cut_anywhere_is_refused() -> None:
    whole = TINY.read_bytes()
    for end in np.linspace(1, len(whole) - 1, 40).astype(int):
        with pytest.raises(ModelError):
            ElfRuntime(whole[:end])


def test_a_foreign_model_is_told_apart(tmp_path: Path) -> None:
    """The tiny model with its metadata keys overwritten, byte for byte as long: valid ONNX, no contract."""
    path = tmp_path / "foreign.onnx"
    path.write_bytes(TINY.read_bytes().replace(b"elf.", b"xyz."))
    with pytest.raises(ContractError, match=r"foreign\.onnx: not an ELF model"):
        ElfRuntime(path)


def test_a_contract_at_odds_with_the_graph(tmp_path: Path) -> None:
    path = tmp_path / "odd.onnx"
    path.write_bytes(TINY.read_bytes().replace(b'"descriptors_relu2"', b'"descriptors_relu9"'))
    with pytest.raises(ContractError, match=r"odd\.onnx: 'elf\.descriptors' says output 'descriptors_relu9'"):
        ElfRuntime(path)


def test_models_from_bytes_and_text_paths(tmp_path: Path, image: np.ndarray) -> None:
    path = shutil.copy(TINY, tmp_path / "spaß mit leerzeichen.onnx")
    assert same(ElfRuntime(str(path)).detect(image), ElfRuntime(TINY.read_bytes()).detect(image), 1e-4)


def test_providers() -> None:
    assert ElfRuntime(TINY, providers="cpu").providers == ["CPUExecutionProvider"]
    assert ElfRuntime(TINY, providers=[("CPUExecutionProvider", {})]).providers == ["CPUExecutionProvider"]
    with pytest.raises(ProviderError, match="unknown provider 'warp'"):
        ElfRuntime(TINY, providers="warp")
    with pytest.raises(ProviderError, match="unknown provider 'warp'"):
        ElfRuntime(TINY, providers=["warp"], fallback=True)
    with pytest.raises(ProviderError, match="empty"):
        ElfRuntime(TINY, providers=[])
    for odd in (3, [3], ("cpu", None), {"cpu": {}}, [("cpu",)], b"cpu"):
        with pytest.raises(ProviderError, match="a provider is a name, or a pair of a name and its options"):
            ElfRuntime(TINY, providers=odd)  # type: ignore[arg-type]
    with pytest.raises(ProviderError, match="the options of provider 'cpu' are a mapping, not 3"):
        ElfRuntime(TINY, providers=[("cpu", 3)])  # type: ignore[list-item]
    for threads in (0, -1, 1.5, True):
        with pytest.raises(ProviderError, match="threads"):
            ElfRuntime(TINY, threads=threads)  # type: ignore[arg-type]
    assert len(ElfRuntime(TINY, threads=np.int64(2)).detect(textured(64, 80)))  # type: ignore[arg-type]
    for spin in ("yes", 1, 0):
        with pytest.raises(ProviderError, match=f"spin is None, True or False, not {spin!r}"):
            ElfRuntime(TINY, spin=spin)  # type: ignore[arg-type]


def test_a_provider_that_is_not_installed() -> None:
    import onnxruntime

    missing = next(p for p in onnxruntime.get_all_providers() if p not in onnxruntime.get_available_providers())
    with pytest.raises(ProviderError, match=f"{missing} is not in the installed onnxruntime") as caught:
        ElfRuntime(TINY, providers=[missing, "cpu"])
    assert "fallback" not in str(caught.value)  # which no command has
    with pytest.warns(RuntimeWarning, match=missing):
        assert ElfRuntime(TINY, providers=[missing], fallback=True).providers == ["CPUExecutionProvider"]


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (MemoryError(), "MemoryError"),
        (RuntimeError("no room\nat 0x7f"), "no room"),
        (RuntimeError("x" * 999), "x" * 300),
    ],
)
def test_a_network_that_fails_says_why_in_one_line(
    error: Exception, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Failing:
        def run(self, *_: object) -> None:
            raise error

    elf = ElfRuntime(TINY)
    monkeypatch.setattr(elf._network.sessions, "get", lambda *_: (Failing(), None))
    with pytest.raises(ElfError) as caught:
        elf.detect(textured(64, 80))
    assert str(caught.value) == f"{TINY}: the network failed on a (1, 64, 80, 3) input: {text}"


def test_a_detectionparams_is_where_to_start_from(elf: ElfRuntime, image: np.ndarray) -> None:
    params = DetectionParams(max_keypoints=9, nms_radius=3, threshold="none", scale=0.7)
    wanted = elf.detect(image, **params.to_dict())
    assert same(elf.detect(image, params=params), wanted)
    assert same(elf.detect_batch([image], params=params)[0], wanted)
    assert len(elf.detect(image, params=params, max_keypoints=4)) == 4
    np.testing.assert_array_equal(elf.saliency(image, params=params), elf.saliency(image, scale=0.7))
    np.testing.assert_array_equal(
        elf.describe(image, wanted.keypoints, params=params), elf.describe(image, wanted.keypoints, scale=0.7)
    )
    elf.warmup((64, 64), params=params)
    with pytest.raises(SettingError, match="preset 'fast' and params are both where to start from"):
        elf.detect(image, preset="fast", params=params)
    with pytest.raises(SettingError, match="params is a DetectionParams, not dict"):
        elf.detect(image, params=params.to_dict())


def test_what_is_shown_is_short(elf: ElfRuntime, image: np.ndarray) -> None:
    traced = elf.trace(image)
    for value in (traced, traced.features, elf, elf.contract, read_onnx(TINY)):
        assert len(repr(value)) < 300
        assert "\n" not in repr(value)
    assert repr(traced.features) == f"Features({len(traced.features)} keypoints, descriptors of 8, image 160x120)"


def test_a_model_that_can_t_be_cut_runs_whole(
    elf: ElfRuntime, image: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nodes with graphs of their own (If, Loop) may read any value from outside."""
    points = [(20.0, 30.0), (70.5, 40.25)]
    wanted, saliency = elf.describe(image, points), elf.saliency(image)

    def refused(*_: object) -> bytes:
        raise ModelError("node 'l' (Loop) has a graph of its own")

    monkeypatch.setattr("elf_runtime.model.sessions.with_outputs", refused)
    whole = ElfRuntime(TINY, threads=1)
    np.testing.assert_allclose(whole.describe(image, points), wanted, atol=1e-5)
    np.testing.assert_allclose(whole.saliency(image), saliency, atol=1e-4)
    assert len(whole._network.sessions) == 1


def test_users_see_one_class_only() -> None:
    calls: list[Callable[..., object]] = [ElfRuntime, ElfRuntime(TINY).describe, ElfRuntime(TINY).saliency]
    for call in calls:
        with pytest.raises(TypeError, match=r"^ElfRuntime\.\w+\(\) got an unexpected keyword argument 'foo'"):
            call(foo=1)
    assert "max_pixels" in inspect.signature(ElfRuntime).parameters
    assert "Open and check a model" in str(ElfRuntime.__init__.__doc__)


def test_what_can_t_be_worked_on_is_said_before_any_work(elf: ElfRuntime, image: np.ndarray) -> None:
    with pytest.raises(ImageError, match="the image has 1000000x1000000 pixels, more than the limit of 100,000,000"):
        elf.warmup((10**6, 10**6))
    with pytest.raises(SettingError, match=r"^a batch is a list of images, not 'a\.jpg'; give \['a\.jpg'\]$"):
        elf.detect_batch("a.jpg")
    with pytest.raises(SettingError, match=r"points are all cv2\.KeyPoint, or all \(x, y\)"):
        elf.describe(image, [cv2.KeyPoint(1, 2, 3), (1, 2)])
    with pytest.raises(SettingError, match=r"points are all cv2\.KeyPoint, or all \(x, y\)"):
        elf.describe(image, [(1, 2), cv2.KeyPoint(1, 2, 3)])
