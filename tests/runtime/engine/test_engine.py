"""ElfRuntime on a small model: every kind of input and setting, and the defined empty result."""

from __future__ import annotations

import inspect
import shutil
import threading
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime import DetectionParams, ElfRuntime, Features, ImageError, ModelError, SettingError, match
from elf_runtime.model.onnx_file import read_onnx
from helpers import TINY, textured


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


@pytest.mark.parametrize("quantize", [False, True])
def test_scores_are_floats_at_the_keypoints(elf: ElfRuntime, image: np.ndarray, quantize: bool) -> None:
    traced = elf.trace(image, quantize=quantize, scale=1.0, border=7, subpixel=False)
    assert traced.scores.dtype == traced.features.scores.dtype == np.float32
    x, y = traced.features.keypoints.astype(int).T
    assert len(x)
    np.testing.assert_array_equal(traced.features.scores, traced.scores[y, x])
    assert traced.mask[y, x].all()


def test_a_flat_image_is_the_empty_result(elf: ElfRuntime) -> None:
    for value in (0, 128, 255, (200, 100, 50)):
        flat = np.full((64, 64, 3), value, np.uint8)
        f = elf.detect(flat)
        assert (f.keypoints.shape, f.scores.shape, f.descriptors.shape) == ((0, 2), (0,), (0, 8))
        assert not elf.saliency(flat).any()
        assert elf.detect(flat, nms_radius=3).nms_radius == 3


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


def test_models_from_bytes_and_text_paths(tmp_path: Path, image: np.ndarray) -> None:
    path = shutil.copy(TINY, tmp_path / "spaß mit leerzeichen.onnx")
    assert same(ElfRuntime(str(path)).detect(image), ElfRuntime(TINY.read_bytes()).detect(image), 1e-4)


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
