"""Where keypoints may lie: limits, masks, the border, and the radius of the suppression."""

from __future__ import annotations

import numpy as np
import pytest

from elf_runtime import DetectionParams, ElfRuntime, InputSpec, ModelContract
from elf_runtime.detection.refine import quadratic_peaks
from elf_runtime.detection.working_image import prepare
from helpers import textured


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
    (work,) = elf._prepare(image, elf.params(**settings), None).image
    rows, columns = work.scaling.margin(10)
    assert rows != columns
    found = elf.trace(image, **settings)
    assert len(found.features) > 5
    x, y = np.rint(work.scaling.to_working(found.features.keypoints)).astype(int).T
    np.testing.assert_array_equal(found.scores[y, x], found.features.scores)


def test_a_refined_point_at_the_border_stays(elf: ElfRuntime) -> None:
    (work,) = elf._prepare(textured(60, 80), elf.params(scale=1.0), None).image
    refined = np.array([[10.0, 20.25], [69.0, 49.0], [9.75, 20.25]], np.float32)
    found = np.array([[10, 20], [69, 49], [10, 20]])
    np.testing.assert_array_equal(work.kept_inside(refined, found, 10), [[10.0, 20.25], [69.0, 49.0], [10.0, 20.0]])


def test_a_radius_is_at_least_a_working_pixel_where_above_zero(elf: ElfRuntime) -> None:
    (work,) = elf._prepare(textured(160, 200), elf.params(scale=0.25), None).image
    assert [work.scaling.radius(r) for r in (0, 1, 4, 6, 10_000)] == [0, 1, 1, 2, 50]


def test_the_radius_of_a_model_of_one_size_is_in_source_pixels() -> None:
    contract = ModelContract("net", "layer", 2.0, input=InputSpec(height=60, width=80))
    (work,) = prepare(textured(120, 160), DetectionParams(), None, contract, "m.onnx")
    assert work.scaling.scale == 0.5
    assert work.scaling.radius(10) == 5


def test_without_border_and_mask_every_place_is_refined(elf: ElfRuntime, image: np.ndarray) -> None:
    settings = {"scale": 0.45, "border": 0, "threshold": "none"}
    traced = elf.trace(image, subpixel=True, **settings)
    whole = elf.trace(image, subpixel=False, **settings).features.keypoints
    size, working = np.array([160, 120]), np.array(traced.scores.shape[::-1])
    found = np.rint((whole + 0.5) * working / size - 0.5).astype(np.int64)
    refined = (quadratic_peaks(traced.scores, found) + 0.5) * size / working - 0.5
    np.testing.assert_allclose(traced.features.keypoints, refined, atol=1e-3)
    assert (traced.features.keypoints != whole).any()


def test_lengths_beyond_the_image_are_the_image(elf: ElfRuntime, image: np.ndarray) -> None:
    one = elf.detect(image, nms_radius=160, border=0)
    assert len(one) == 1
    for length in (3000, 10**20, 10**400):
        found = elf.detect(image, nms_radius=length, border=0)
        np.testing.assert_array_equal(found.keypoints, one.keypoints)
        assert len(elf.detect(image, border=length, subpixel=True)) == 0
