"""The least contrast in grey levels: a blank wall has no keypoints, whatever its noise looks like under a magnifier."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from elf_runtime import ElfRuntime
from elf_runtime.detection.contrast import contrast_at, contrast_map, window_for
from helpers import ROOT, textured

PRESETS = ("fast", "default", "accurate")


@pytest.fixture(scope="module")
def elf() -> ElfRuntime:
    return ElfRuntime(threads=1)


@pytest.fixture(scope="module")
def photo() -> npt.NDArray[np.uint8]:
    return np.asarray(cv2.imread(str(ROOT / "demo" / "palace.jpg")), np.uint8)


def by_least_squares(pixels: np.ndarray, x: int, y: int, window: int) -> float:
    """Oracle: fit a plane to the window by numpy's least squares, and take the deviation of what it leaves."""
    r = window // 2
    framed = np.pad(pixels.astype(np.float64), ((r, r), (r, r), (0, 0)), mode="reflect")
    part = framed[y : y + window, x : x + window]
    rows, columns = np.mgrid[:window, :window]
    plane = np.stack([np.ones(window**2), rows.ravel(), columns.ravel()], axis=1)
    variances = []
    for channel in np.moveaxis(part, 2, 0):
        fitted = plane @ np.linalg.lstsq(plane, channel.ravel(), rcond=None)[0]
        variances.append(np.mean((channel.ravel() - fitted) ** 2))
    return float(np.sqrt(np.mean(variances)))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("window", [3, 11, 21])
def test_contrast_is_what_a_fitted_plane_leaves(channels: int, window: int) -> None:
    pixels = textured(40, 56, channels=channels).reshape(40, 56, channels).astype(np.float32)
    rng = np.random.default_rng(window)
    points = np.stack([rng.integers(0, 56, 30), rng.integers(0, 40, 30)], axis=1)
    points[:4] = [(0, 0), (55, 0), (0, 39), (55, 39)]
    wanted = [by_least_squares(pixels, x, y, window) for x, y in points]
    np.testing.assert_allclose(contrast_at(pixels, points, window), wanted, rtol=1e-5)
    found = contrast_map(pixels, window)[points[:, 1], points[:, 0]]
    np.testing.assert_allclose(found, wanted, rtol=1e-3, atol=2e-2)


@pytest.mark.parametrize(("field", "size", "side"), [
    (0, (100, 100), 11), (10, (100, 100), 11), (12, (100, 100), 11), (13, (100, 100), 13), (44, (60, 90), 43),
    (1e9, (64, 80), 63), (10, (8, 90), 7), (10, (1, 90), 3), (10, (2, 2), 3), (99, (99, 99), 99),
])  # fmt: skip
def test_the_window_is_odd_and_within_the_image(field: float, size: tuple[int, int], side: int) -> None:
    assert window_for(field, size) == side
    pixels = np.random.default_rng(0).random((*size, 3), np.float32)
    found = contrast_map(pixels, side)
    assert found.shape == size
    corner = np.array([[0, 0], [size[1] - 1, size[0] - 1]])
    np.testing.assert_allclose(contrast_at(pixels, corner, side), found[[0, -1], [0, -1]], atol=1e-3)


def test_a_ramp_has_no_contrast_and_noise_has_its_deviation() -> None:
    ramp = np.add.outer(np.arange(60.0), 2 * np.arange(80.0)).astype(np.float32)[:, :, None]
    assert contrast_map(ramp, 11)[6:-6, 6:-6].max() < 0.05
    noise = np.random.default_rng(0).normal(0, 5, (200, 200, 1)).astype(np.float32)
    assert np.median(contrast_map(noise, 11)) == pytest.approx(5.0, rel=0.03)


def frame(sigma: float, *, colour: bool, level: float = 128.0, slope: float = 0.0) -> npt.NDArray[np.uint8]:
    rng = np.random.default_rng(int(10 * sigma))
    light = level + slope * np.arange(640.0)[:, None]
    noise = rng.normal(0, sigma, (480, 640, 3 if colour else 1))
    return np.clip(light + noise, 0, 255).round().astype(np.uint8)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("sigma", [0.3, 1.0])
def test_a_blank_noisy_frame_has_no_keypoints(elf: ElfRuntime, preset: str, sigma: float) -> None:
    frames = [frame(sigma, colour=False), frame(sigma, colour=True), frame(sigma, colour=False, level=20)]
    frames.append(frame(sigma, colour=False, level=60, slope=0.25))  # lit from the side
    assert [len(elf.detect(image, preset=preset)) for image in frames] == [0, 0, 0, 0]


@pytest.mark.parametrize("convert", [
    lambda image: image.astype(np.uint16) * np.uint16(257), lambda image: (image / 255).astype(np.float32),
    lambda image: image.astype(np.uint16) * np.uint16(16),
], ids=["16 bits", "float", "12 bits"])  # fmt: skip
def test_grey_levels_are_those_of_the_full_range(elf: ElfRuntime, photo: np.ndarray, convert: object) -> None:
    assert callable(convert)
    assert len(elf.detect(convert(frame(1.0, colour=False)))) == 0
    assert len(elf.detect(convert(photo))) == 500


@pytest.mark.parametrize("preset", PRESETS)
def test_a_photograph_keeps_all_its_keypoints(elf: ElfRuntime, photo: np.ndarray, preset: str) -> None:
    with_it, without = (elf.detect(photo, preset=preset, min_contrast=least) for least in (None, 0.0))
    np.testing.assert_array_equal(with_it.keypoints, without.keypoints)
    np.testing.assert_array_equal(with_it.descriptors, without.descriptors)


def test_a_weak_half_is_left_out_and_the_rest_stays(elf: ElfRuntime, photo: np.ndarray) -> None:
    """As if those pixels had not passed: keypoints elsewhere are those of a detection without them."""
    half = photo.copy()
    half[:, 320:] = frame(1.0, colour=True)[: photo.shape[0], 320:]
    free = elf.trace(half, threshold="none", min_contrast=0.0, max_keypoints=2000)
    held = elf.trace(half, threshold="none", max_keypoints=2000)
    assert (free.features.keypoints[:, 0] > 345).sum() > 100
    assert (held.features.keypoints[:, 0] > 345).sum() == 0
    assert (held.features.keypoints[:, 0] < 320).sum() > 300
    size = held.scores.shape[::-1]
    working = cv2.resize(half.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    places = np.rint((held.features.keypoints + 0.5) * size / (640, 427) - 0.5).astype(np.int64)
    assert contrast_at(working, places, 11).min() > 1.4
    assert held.mask.sum() < free.mask.sum()


def test_the_paper_s_settings_have_none(elf: ElfRuntime) -> None:
    assert elf.params("paper").min_contrast == 0.0
    assert len(elf.detect(frame(1.0, colour=False), preset="paper")) > 100
