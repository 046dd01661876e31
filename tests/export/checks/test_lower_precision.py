"""A lower precision beside float32: its figures against hand-computed ones, and the views that they are taken over."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from elf_export import ExportError, VerificationError
from elf_export.calibration import CalibrationSet, calibration_set
from elf_export.checks import lower_precision, require, views
from elf_runtime import DetectionParams, Features, InputSpec
from helpers import textured


def features(points: Any, descriptors: Any = None, size: tuple[int, int] = (60, 100)) -> Features:
    keypoints = np.asarray(points, np.float32).reshape(-1, 2)
    values = np.zeros((len(keypoints), 0)) if descriptors is None else descriptors
    return Features(keypoints, np.ones(len(keypoints), np.float32), np.asarray(values, np.float32), size)


def folder_of(folder: Path, *sizes: tuple[int, int]) -> CalibrationSet:
    for index, size in enumerate(sizes):
        assert cv2.imwrite(str(folder / f"{index}.png"), textured(*size, index))
    return calibration_set(folder)


# -- scores --------------------------------------------------------------------------------------------------------

SHIFT = np.array([[1.0, 0.0, 30.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
POINTS = np.array([[20.0, 10.0], [60.0, 30.0], [10.0, 50.0], [90.0, 20.0]])  # the last is not in the view


def test_scores_are_of_keypoints_that_both_images_show() -> None:
    """Three of each image's four, all in place; where the descriptors of two are exchanged, one is matched."""
    first, places = features(POINTS, np.eye(4)), [[10.0, 40.0], *np.add(POINTS[:3], (30, 0))]
    for order, matched in (([3, 0, 1, 2], 100.0), ([3, 0, 2, 1], 100 / 3)):
        second = features(places, np.eye(4)[order])
        assert lower_precision._scores(first, second, SHIFT) == (pytest.approx(100.0), pytest.approx(matched))


def test_keypoints_are_repeated_within_5_pixels() -> None:
    second = np.add(POINTS[:2], ((34, 3), (35.01, 0)))
    assert lower_precision._scores(features(POINTS), features(second), SHIFT) == (pytest.approx(50.0), 0.0)
    assert lower_precision._scores(features([]), features(second), SHIFT) == (0.0, 0.0)


def test_a_keypoint_is_near_another_up_to_a_pixel_away() -> None:
    assert lower_precision._near(features([[5, 5], [5, 5.25]]).keypoints, features([[5, 4]]).keypoints) == 0.5


# -- images and their views ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("index", range(4))
def test_a_view_shows_the_image_where_the_homography_says(index: int) -> None:
    image = textured(120, 200, 1)
    view, homography = views.view_of(image, index)
    assert (view.shape, view.dtype) == (image.shape, np.uint8)
    grid = np.stack(np.meshgrid(np.arange(30, 170, 3), np.arange(20, 100, 3)), -1).reshape(-1, 2)
    moved = np.c_[grid, np.ones(len(grid))] @ homography.T
    x, y = np.round(moved[:, :2] / moved[:, 2:]).astype(int).T
    one, other = image[grid[:, 1], grid[:, 0]].ravel(), view[y, x].ravel()
    assert np.corrcoef(one, other)[0, 1] > 0.97
    assert np.abs(moved[:, :2] / moved[:, 2:] - grid).max() > 2


def test_views_differ_and_are_cut_off_at_white() -> None:
    white = np.full((60, 80, 3), 255, np.uint8)
    shown, homographies = zip(*(views.view_of(white, index) for index in range(6)), strict=True)
    inner = np.array([view[20:40, 30:50].mean() for view in shown])
    assert 0.69 * 255 < inner.min() < inner.max() <= 255
    assert len({tuple(h.ravel()) for h in homographies}) == 6
    assert min(view[20:40, 30:50].min() for view in shown) > 0.6 * 255


def test_images_are_640_pixels_large_at_most_and_the_exporter_s_own_as_in_calibration(tmp_path: Path) -> None:
    images = folder_of(tmp_path, (100, 1280), (900, 300), (40, 60))
    sizes = [image.shape for image in views.sources(images, InputSpec(), 0.5)]
    assert sizes == [(50, 640, 3), (640, 213, 3), (40, 60, 3)]
    ready = CalibrationSet(images.name, images.files[2:], images.sha256, ready=True)
    assert [image.shape for image in views.sources(ready, InputSpec(), 0.5)] == [(80, 120, 3)]
    (tmp_path / "0.png").write_bytes(b"no image")
    with pytest.raises(ExportError, match=r"0\.png: not an image that OpenCV can decode"):
        list(views.sources(images, InputSpec(), 0.5))


# -- the measure ---------------------------------------------------------------------------------------------------


class Scripted:
    """A runtime that answers each image with the next of its traces."""

    traces: dict[bytes, Iterator[Any]]
    described: tuple[str, ...] = ("relu2",)

    def __init__(self, model: bytes) -> None:
        self.model = model
        detection = DetectionParams(scale=0.5 if model == b"full" else 1.0)
        self.contract = SimpleNamespace(
            precision="int8", descriptors=self.described, detection=detection, input=InputSpec()
        )

    def trace(self, image: np.ndarray) -> Any:
        return next(self.traces[self.model])


def trace(saliency: Any, count: int, seconds: float = 1.0) -> Any:
    points = np.stack([10.0 * np.arange(count), np.zeros(count)], axis=1)
    return SimpleNamespace(
        saliency=np.asarray(saliency, np.float32), features=features(points), seconds={"session": seconds}
    )


UP, ZIGZAG, FLAT = [0, 1, 2, 3], [0, 2, 1, 3], [1, 1, 1, 1]  # UP and ZIGZAG correlate by 0.8


@pytest.fixture
def scripted(monkeypatch: pytest.MonkeyPatch) -> type[Scripted]:
    """Scores tell which traces they are of: ten times the first's keypoints, and the view's."""
    monkeypatch.setattr(lower_precision, "ElfRuntime", Scripted)
    monkeypatch.setattr(lower_precision, "_scores", lambda one, view, _: (10.0 * len(one), float(len(view))))
    monkeypatch.setattr(Scripted, "described", ("relu2",))
    return Scripted


def test_figures_are_means_over_the_images_and_the_time_is_a_median(tmp_path: Path, scripted: type[Scripted]) -> None:
    images = folder_of(tmp_path, (40, 60), (40, 60), (40, 60))

    def play() -> lower_precision.PrecisionCheck:
        scripted.traces = {
            b"lower": iter([trace(UP, 2), trace(UP, 7, 1.0), trace(ZIGZAG, 1), trace(UP, 7, 3.0),
                            trace(FLAT, 3), trace(UP, 10, 9.0)]),
            b"full": iter([trace(UP, 4), trace(UP, 5, 2.0), trace(UP, 4), trace(UP, 5, 2.0),
                           trace(UP, 4), trace(UP, 8, 3.0)]),
        }  # fmt: skip
        return lower_precision.measure(b"lower", b"full", images)

    found = play()
    assert found.correlation == pytest.approx((1 + 0.8 + 0) / 3)
    assert found.agreeing == pytest.approx((2 / 4 + 1 / 4 + 3 / 4) / 3)
    assert (found.keypoints, found.keypoints_fp32) == (2, 4)
    assert (found.rep, found.rep_fp32, found.ms, found.ms_fp32) == (20, 40, 8, 6)
    assert found.time == 1.5
    scripted.described = ()
    without = play()
    assert (without.ms, without.ms_fp32) == (None, None)
    assert without.figures().keys() == found.figures().keys() - {"lower_ms", "lower_ms_fp32"}


@pytest.mark.parametrize(
    ("saliency", "message"),
    [
        ([0, 1, np.inf, 3], "int8 overflows in this network: its saliency is not finite"),
        ([1, 3, 0, 2], r"int8 loses the saliency .* is 0\.000, at least 0\.5 is wanted"),
        ([1, 0, 3, 2][::-1], r"int8 loses the saliency .* is -0\.600"),
        (FLAT, r"int8 loses the saliency .* is 0\.000"),
    ],
)
def test_a_saliency_that_is_lost_is_refused(
    tmp_path: Path, scripted: type[Scripted], saliency: list[float], message: str
) -> None:
    images = folder_of(tmp_path, (40, 60))
    scripted.traces = {
        b"lower": iter([trace(saliency, 4), trace(UP, 4)]), b"full": iter([trace(UP, 4), trace(UP, 4)])
    }  # fmt: skip
    with pytest.raises(VerificationError, match=message):
        require(lower_precision.measure(b"lower", b"full", images))


def test_half_the_correlation_is_enough(tmp_path: Path, scripted: type[Scripted]) -> None:
    images = folder_of(tmp_path, (40, 60))
    for nearly, refused in ((0.52, False), (0.48, True)):
        rest = (1 - nearly**2) ** 0.5
        # Of the same length as UP's deviation and at right angles to it, so that `nearly` is their correlation.
        lower = nearly * np.array([-3, -1, 1, 3]) + rest * np.array([1, -3, 3, -1])
        scripted.traces = {
            b"lower": iter([trace(lower, 4), trace(UP, 4)]), b"full": iter([trace(UP, 4), trace(UP, 4)])
        }  # fmt: skip
        if refused:
            with pytest.raises(VerificationError, match=r"is 0\.480"):
                require(lower_precision.measure(b"lower", b"full", images))
        else:
            assert lower_precision.measure(b"lower", b"full", images).correlation == pytest.approx(nearly)


def test_the_exporter_s_photographs_are_seen_at_float32_s_working_scale(
    tmp_path: Path, scripted: type[Scripted], monkeypatch: pytest.MonkeyPatch
) -> None:
    images = folder_of(tmp_path, (40, 60))
    ready = CalibrationSet(images.name, images.files, images.sha256, ready=True)
    seen: list[tuple[int, ...]] = []

    def shown(self: Scripted, image: np.ndarray) -> Any:
        seen.append(image.shape)
        return trace(UP, 4)

    monkeypatch.setattr(Scripted, "trace", shown)
    lower_precision.measure(b"lower", b"full", ready)
    assert seen == [(80, 120, 3)] * 4


def test_no_gain_is_said_from_97_hundredths_on() -> None:
    for time, said in ((0.96, False), (0.98, True)):
        found = lower_precision.PrecisionCheck("int8", 0.97, 0.0, 490.0, 500.0, 0.0, 71.5, 47.9, 48.0, time)
        assert ("int8 is no faster here" in found.table()) is said
        assert found.figures()["lower_agreeing"] == found.figures()["lower_rep"] == 0.0
