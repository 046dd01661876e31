"""Masks and alpha channels: no keypoints where there is no image, nor where the network sees the edge of it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from elf_runtime import DetectionParams, ElfRuntime, ImageError, SettingError
from elf_runtime.commands import detect as detect_command
from elf_runtime.detection.threshold import blurred, passing
from elf_runtime.image import read
from elf_runtime.image.masks import shrunk
from helpers import ROOT, textured


@pytest.fixture(scope="module")
def elf() -> ElfRuntime:
    return ElfRuntime(threads=1)


@pytest.fixture(scope="module")
def scene() -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """A photograph that lies askew on black ground, and what of the frame it covers."""
    photo = cv2.imread(str(ROOT / "demo" / "palace.jpg"))
    height, width = photo.shape[:2]
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), 25, 0.8)
    whole = np.full((height, width), 255, np.uint8)
    return (
        np.asarray(cv2.warpAffine(photo, turn, (width, height)), np.uint8),
        np.asarray(cv2.warpAffine(whole, turn, (width, height), flags=cv2.INTER_NEAREST), np.uint8),
    )


def distance_to_edge(mask: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How many pixels, along x or y whichever is more, each point is away from what the mask leaves out."""
    x, y = np.rint(points).astype(int).T
    framed = np.pad(mask, 200, mode="edge")
    return np.asarray(cv2.distanceTransform(framed, cv2.DIST_C, 3)[y + 200, x + 200])


@pytest.mark.parametrize(("preset", "least"), [("fast", 17), ("default", 15), ("accurate", 6)])
def test_keypoints_keep_away_from_a_mask_s_edge(
    elf: ElfRuntime, scene: tuple[np.ndarray, np.ndarray], preset: str, least: int
) -> None:
    """Half of relu2_1's field of 10 pixels and half the blur's window, at the working scale."""
    picture, mask = scene
    found = elf.detect(picture, preset=preset, mask=mask)
    assert len(found) > 200
    assert distance_to_edge(mask, found.keypoints).min() > least
    near = elf.detect(picture, preset=preset, mask=mask, mask_border=0)
    assert distance_to_edge(mask, near.keypoints).min() <= 3
    some = elf.detect(picture, preset=preset, mask=mask, mask_border=40)
    assert distance_to_edge(mask, some.keypoints).min() > 40


def test_alpha_is_a_mask_as_array_and_as_file(
    elf: ElfRuntime, scene: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    picture, mask = scene
    wanted = elf.detect(picture, mask=mask).keypoints
    with_alpha = np.dstack([picture, mask])
    np.testing.assert_array_equal(elf.detect(with_alpha).keypoints, wanted)
    batch = elf.detect_batch([with_alpha, picture], masks=[None, mask])
    np.testing.assert_array_equal(batch[0].keypoints, batch[1].keypoints)
    assert len(batch[0]) == pytest.approx(len(wanted), rel=0.02)
    cv2.imwrite(str(tmp_path / "a.png"), with_alpha)
    np.testing.assert_array_equal(elf.detect(tmp_path / "a.png").keypoints, wanted)
    # These writers put other colours where nothing is to be seen.
    for name, options in (("a.tiff", []), ("a.webp", [cv2.IMWRITE_WEBP_QUALITY, 101])):
        cv2.imwrite(str(tmp_path / name), with_alpha, options)
        found = elf.detect(tmp_path / name)
        assert len(found) == pytest.approx(len(wanted), rel=0.02)
        assert distance_to_edge(mask, found.keypoints).min() > 14
    deep = with_alpha.astype(np.uint16) * np.uint16(257)
    cv2.imwrite(str(tmp_path / "deep.png"), deep)
    assert read(tmp_path / "deep.png").shape == deep.shape
    assert distance_to_edge(mask, elf.detect(tmp_path / "deep.png").keypoints).min() > 14


def test_mask_and_alpha_together(elf: ElfRuntime, scene: tuple[np.ndarray, np.ndarray]) -> None:
    picture, mask = scene
    left = np.zeros(mask.shape, np.uint8)
    left[:, :300] = 1
    both = elf.detect(np.dstack([picture, mask]), mask=left).keypoints
    np.testing.assert_array_equal(both, elf.detect(picture, mask=(mask > 0) & (left > 0)).keypoints)


def test_only_alpha_of_zero_is_no_image(elf: ElfRuntime) -> None:
    image = textured(160, 200)
    faint = np.dstack([image, np.full((160, 200), 1, np.uint8)])
    np.testing.assert_array_equal(elf.detect(faint).keypoints, elf.detect(image).keypoints)
    assert len(elf.detect(np.dstack([image, np.zeros((160, 200), np.uint8)]))) == 0


def test_a_mask_file_with_alpha(scene: tuple[np.ndarray, np.ndarray], tmp_path: Path) -> None:
    """White where it counts, and cut out: what is cut out does not count."""
    picture, mask = scene
    cv2.imwrite(str(tmp_path / "photo.png"), picture)
    cv2.imwrite(str(tmp_path / "mask.png"), np.dstack([np.full_like(picture, 255), mask]))
    command = ["--mask", str(tmp_path / "mask.png"), "--no-picture", "-o", str(tmp_path / "out")]
    assert detect_command.main([str(tmp_path / "photo.png"), *command]) == 0
    found = np.load(next((tmp_path / "out").rglob("photo*.npz")))["keypoints"]
    assert len(found) > 300
    assert distance_to_edge(mask, found).min() > 14


@pytest.mark.parametrize("settings", [{}, {"normalize": 0.95}, {"quantize": True}])
def test_what_is_no_image_does_not_set_the_level(settings: dict[str, float]) -> None:
    """The edge of a bright surround is stronger than anything in the picture."""
    params = DetectionParams(**settings)  # type: ignore[arg-type]
    saliency = textured(80, 120)[:, :, 0].astype(np.float32)
    surround, allowed = saliency.copy(), np.ones((80, 120), np.bool_)
    allowed[:, 60:] = False
    surround[:, 70:] *= 50
    alone = np.ascontiguousarray(surround[:, :70])
    found = passing(*blurred(surround, params, allowed), params, allowed)
    wanted = passing(*blurred(alone, params, allowed[:, :70].copy()), params, allowed[:, :70].copy())
    assert 0.02 < wanted.mean() < 0.9
    np.testing.assert_array_equal(found[:, :70], wanted)
    assert not found[:, 60:].any()


@pytest.mark.parametrize("shape", ["grey", "grey, one channel", "colour", "alpha"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_flat_margin_is_no_blank_image(elf: ElfRuntime, shape: str, dtype: type) -> None:
    """Scans, letterboxed and undistorted pictures have columns and rows of one value."""
    image = textured(160, 200)
    for flat in (np.s_[:, :30], np.s_[:30], np.s_[:, 170:], np.s_[130:]):
        picture = image.copy()
        picture[flat] = 0
        given = {"grey": picture[:, :, 0], "grey, one channel": picture[:, :, :1], "colour": picture}.get(
            shape, np.dstack([picture, np.full((160, 200), 255, np.uint8)])
        )
        given = given.astype(dtype) * dtype(1 if dtype is np.uint8 else 257)
        assert len(elf.detect(given)) > 20
        assert elf.saliency(given).max() > 0
    assert len(elf.detect(np.zeros_like(given))) == 0


@pytest.mark.parametrize("pixels", [0, 1, 5, 100])
def test_shrinking_is_a_plain_loop_s(pixels: int) -> None:
    rng = np.random.default_rng(pixels)
    mask = rng.random((30, 41)) > 0.01
    wanted = mask.copy()
    for y, x in np.argwhere(~mask):
        wanted[max(0, y - pixels) : y + pixels + 1, max(0, x - pixels) : x + pixels + 1] = False
    np.testing.assert_array_equal(shrunk(mask, pixels), wanted)


@pytest.mark.parametrize("value", ["wide", -1, 2.5, None, True, np.zeros(2)])
def test_a_mask_border_is_auto_or_pixels(elf: ElfRuntime, value: object) -> None:
    if value is None:
        assert elf.params(mask_border=None).mask_border == "auto"
        return
    with pytest.raises(SettingError, match="mask_border is 'auto' or an integer >= 0"):
        elf.params(mask_border=value)


def test_alpha_that_is_no_number(elf: ElfRuntime) -> None:
    image = np.dstack([textured(64, 80) / 255.0, np.full((64, 80), np.nan)])
    with pytest.raises(ImageError, match="alpha has NaN or infinite values"):
        elf.detect(image)
