"""Upright patches: where their pixels come from, and how they lie in a sheet."""

from __future__ import annotations

import math

import numpy as np
import pytest

from elf_runtime import DescriptorSpec
from elf_runtime.contract import InputSpec
from elf_runtime.detection.descriptors import DescriptorMap
from elf_runtime.detection.upright import Sheet, UprightPatches, upright_patch
from helpers import textured

PIXELS = textured(60, 80).astype(np.float32)
SPEC = DescriptorSpec("desc", "layer", 3, 4.0, 1.5)


def by_loop(
    pixels: np.ndarray, point: tuple[float, float], angle: float, centre: tuple[float, float], zoom: float
) -> np.ndarray:
    """A patch of 16x16, pixel by pixel, by bilinear interpolation in the mirrored image."""
    margin = 50
    framed = np.pad(pixels.astype(np.float64), ((margin, margin), (margin, margin), (0, 0)), mode="reflect")
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    found = np.zeros((16, 16, pixels.shape[2]))
    for v in range(16):
        for u in range(16):
            dx, dy = zoom * (u - centre[0]), zoom * (v - centre[1])
            x, y = point[0] + c * dx - s * dy + margin, point[1] + s * dx + c * dy + margin
            i, j = math.floor(x), math.floor(y)
            fx, fy = x - i, y - j
            above = framed[j, i] * (1 - fx) + framed[j, i + 1] * fx
            below = framed[j + 1, i] * (1 - fx) + framed[j + 1, i + 1] * fx
            found[v, u] = above * (1 - fy) + below * fy
    return found


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("point", [(40.25, 30.5), (2.0, 1.0), (79.0, 59.0), (0.5, 40.0)])
@pytest.mark.parametrize("angle", [0.0, 30.0, 135.5, 270.0])
@pytest.mark.parametrize("zoom", [0.5, 1.0, 1.7, 2.0])
def test_a_patch_is_the_plain_loop_s(point: tuple[float, float], zoom: float, angle: float, channels: int) -> None:
    pixels, centre = PIXELS[..., :channels], (9.0, 7.5)
    found = upright_patch(np.ascontiguousarray(pixels), np.array(point), angle, np.array(centre), 16, zoom)
    expected = by_loop(pixels, point, angle, centre, zoom)
    steepest = max(np.abs(np.diff(pixels, axis=axis)).max() for axis in (0, 1))
    assert found.shape == expected.shape
    assert np.abs(found - expected).max() < steepest / 16  # OpenCV rounds places to 1/32 of a pixel, along x and y


def test_quarter_turns_are_those_of_numpy() -> None:
    around = PIXELS[30 - 8 : 30 + 9, 40 - 8 : 40 + 9]
    for quarters in range(4):  # what points down, at 90 degrees, comes to point along x
        found = upright_patch(PIXELS, np.array([40.0, 30.0]), 90.0 * quarters, np.array([8.0, 8.0]), 17)
        np.testing.assert_allclose(found, np.rot90(around, quarters), atol=1e-3)


def test_an_image_wider_than_opencv_turns() -> None:
    wide = np.tile(PIXELS, (1, 420, 1))
    assert wide.shape[1] > 32767
    there, here = np.array([80.0 * 415 + 40, 30]), np.array([40.0, 30])
    centre = np.array([8.0, 8.0])
    expected = upright_patch(PIXELS, here, 20.0, centre, 16)
    np.testing.assert_allclose(upright_patch(wide, there, 20.0, centre, 16), expected, atol=1e-3)


@pytest.mark.parametrize(
    ("taken", "stride", "patch", "side"),
    [
        (InputSpec(), 4.0, 32, 256),
        (InputSpec(), 1.0, 32, 256),
        (InputSpec(), 4.5, 36, 256),
        (InputSpec(multiple=24), 16.0, 128, 264),
        (InputSpec(min_size=300), 8.0, 64, 300),
        (InputSpec(), 64.0, 512, 512),
    ],
)
def test_each_keypoint_is_at_a_cell_s_centre_in_the_middle_of_its_patch(
    taken: InputSpec, stride: float, patch: int, side: int
) -> None:
    sheet = Sheet.of(taken, DescriptorSpec("desc", "layer", 3, stride, 1.5))
    assert (sheet.patch, sheet.size) == (patch, (side, side))
    assert len(sheet.centres) == (side // patch) ** 2
    cells = (sheet.centres - 1.5) / stride
    np.testing.assert_allclose(cells, np.rint(cells), atol=1e-4)
    columns = np.arange(len(sheet.centres)) % (side // patch), np.arange(len(sheet.centres)) // (side // patch)
    middles = (np.stack(columns, axis=1) + 0.5) * patch - 0.5
    assert np.abs(sheet.centres - middles).max() <= stride / 2


def test_a_sheet_has_the_patches_in_order_and_else_the_image() -> None:
    sheet = Sheet.of(InputSpec(), SPEC)
    rng = np.random.default_rng(0)
    points, angles = rng.uniform(0, 60, (70, 2)).astype(np.float32), rng.uniform(0, 360, 70).astype(np.float32)
    zooms = rng.uniform(0.5, 2, 70)
    first, second = sheet.filled(PIXELS, points, angles, zooms)
    assert first.shape == second.shape == (256, 256, 3)
    for picture, number in ((first, 11), (second, 64 + 3)):
        row, column = divmod(number % 64, 8)
        centre = sheet.centres[number % 64] - 32 * np.array([column, row])
        point, angle = points[number].astype(np.float64), float(angles[number])
        patch = upright_patch(PIXELS, point, angle, centre, 32, zooms[number])
        np.testing.assert_array_equal(picture[32 * row : 32 * row + 32, 32 * column : 32 * column + 32], patch)
    (blank,) = sheet.filled(PIXELS, points[:1], angles[:1], zooms[:1])
    np.testing.assert_array_equal(second[32:], blank[32:])
    np.testing.assert_allclose(blank.mean(), PIXELS.mean(), rtol=0.02)


def test_descriptors_are_read_at_the_keypoints_whatever_the_number_of_sheets() -> None:
    """With the pixels at cell centres as the descriptor map, a descriptor is the keypoint's own colour."""
    sheet = Sheet.of(InputSpec(), DescriptorSpec("desc", "layer", 3, 2.0, 1.0))
    spec = DescriptorSpec("desc", "layer", 3, 2.0, 1.0)
    patches = UprightPatches(PIXELS, sheet, lambda pixels: DescriptorMap(pixels[1::2, 1::2], spec, "a.onnx"), 3)
    points = np.random.default_rng(0).integers(0, (80, 60), (150, 2)).astype(np.float32)
    colours = PIXELS[points[:, 1].astype(int), points[:, 0].astype(int)]
    expected = colours / np.linalg.norm(colours, axis=1, keepdims=True)
    zooms = np.random.default_rng(1).uniform(0.5, 2, 150)
    np.testing.assert_allclose(patches.at(points, patches.angles(points, zooms), zooms), expected, atol=1e-5)
    assert patches.at(points[:0], points[:0, 0], zooms[:0]).shape == (0, 3)
