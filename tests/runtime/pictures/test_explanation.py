"""The sheet that explains a detection: its panels, the chart's level and curve, and what the trace says of them."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from elf_runtime import ElfRuntime, ImageError, draw_explanation
from elf_runtime.entropy import class_entropies, kapur
from elf_runtime.pictures.chart import ABOVE, BELOW, ENTROPY, LEVEL, histogram_chart
from helpers import TINY, textured


def picture() -> npt.NDArray[np.uint8]:
    return textured(240, 320, channels=3)


@pytest.fixture(scope="module")
def elf() -> ElfRuntime:
    return ElfRuntime()


def test_a_trace_says_which_level_its_mask_is_of(elf: ElfRuntime) -> None:
    for settings in ({}, {"threshold": 0.3}, {"threshold": "none"}, {"preset": "paper"}, {"preset": "multiscale"}):
        for level in elf.trace(picture(), **settings, min_contrast=0).levels:
            passed = level.scores >= level.threshold if level.threshold > 0 else level.scores > 0
            np.testing.assert_array_equal(passed, level.mask)
            if "threshold" in settings:
                assert level.histogram is None
                continue
            assert level.smooth is not None
            assert level.histogram is not None
            counts = np.bincount(level.smooth.astype(np.int64).ravel(), minlength=256)
            np.testing.assert_array_equal(level.histogram, counts)
            assert level.threshold == kapur(counts) + 1


def test_pixels_that_a_mask_leaves_out_are_not_counted(elf: ElfRuntime) -> None:
    mask = np.zeros(picture().shape[:2], np.bool_)
    mask[:, :80] = True
    (level,) = elf.trace(picture(), mask=mask, scale=1.0, mask_border=0).levels
    assert level.histogram is not None
    assert level.histogram.sum() == mask.sum()


def test_cells_of_a_grid_have_levels_of_their_own(elf: ElfRuntime) -> None:
    (level,) = elf.trace(picture(), grid=(2, 2)).levels
    assert math.isnan(level.threshold)
    assert level.smooth is level.histogram is None


def test_the_classes_entropies_are_those_of_a_plain_loop() -> None:
    counts = np.random.default_rng(3).integers(0, 9, 32)
    counts[:3] = counts[-2:] = 0
    found = class_entropies(counts)
    for t in range(31):
        total = 0.0
        for part in (counts[: t + 1], counts[t + 1 :]):
            total += sum(-n / part.sum() * math.log(n / part.sum()) for n in part if n) if part.sum() else -math.inf
        assert found[t] == pytest.approx(total)


@pytest.mark.parametrize(
    ("settings", "rows"),
    [
        ({}, 2),
        ({"threshold": "none"}, 2),
        ({"grid": (3, 4)}, 2),
        ({"preset": "multiscale"}, 4),
        ({"preset": "paper"}, 2),
    ],
)
def test_a_sheet_has_a_row_for_each_scale(elf: ElfRuntime, settings: dict[str, Any], rows: int) -> None:
    image = picture()
    trace = elf.trace(image, **settings)
    sheet = draw_explanation(image, trace, "name.png")
    assert len(trace.levels) == rows - 1
    assert sheet.dtype == np.uint8
    assert sheet.shape[0] >= rows * 330
    assert (sheet[60:300, 60:300] > 40).any()


def test_the_contour_is_where_the_map_crosses_the_level(elf: ElfRuntime) -> None:
    image = textured(400, 480, channels=3)
    trace = elf.trace(image, scale=1.0)
    (level,) = trace.levels
    sheet = draw_explanation(image, trace)
    top = sheet.shape[0] - 400 if sheet.shape[0] > 800 else 460
    panel = sheet[top : top + 400, 480 + 6 : 2 * 480 + 6].astype(int)
    assert level.smooth is not None
    passed = (level.smooth >= level.threshold).astype(np.uint8)
    inner = passed - cv2.erode(passed, cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)))
    white = panel.min(axis=2) > 200
    assert white[inner > 0].mean() > 0.9
    assert white[cv2.dilate(inner, np.ones((5, 5), np.uint8)) == 0].mean() < 0.02


def test_a_flat_image_has_a_sheet(elf: ElfRuntime) -> None:
    flat = np.full((64, 64), 90, np.uint8)
    assert draw_explanation(flat, elf.trace(flat)).ndim == 3


def test_a_sheet_wants_the_image_of_its_trace(elf: ElfRuntime) -> None:
    with pytest.raises(ImageError, match="that of the features"):
        draw_explanation(np.zeros((50, 60), np.uint8), elf.trace(picture()))


def test_the_chart_parts_its_bars_at_the_level_and_the_curve_peaks_there() -> None:
    counts = np.full(256, 50.0, np.float32)
    counts[80:120] = 3
    level = kapur(counts) + 1
    chart = histogram_chart(np.zeros((4, 4), np.float32), counts, level, (400, 552))
    left, bottom, step = 20, 400 - 34, 2
    for i in (5, 60, 200, 250):
        np.testing.assert_array_equal(chart[bottom - 3, left + i * step], ABOVE if i >= level else BELOW)
    columns = np.flatnonzero((chart[90:bottom] == LEVEL).all(axis=2).sum(axis=0) > 200)
    assert abs(columns.mean() - (left + level * step)) <= 1
    rows, at = np.nonzero((chart[52:bottom] == ENTROPY).all(axis=2))
    assert abs(np.median(at[rows == rows.min()]) - (left + level * step)) <= 8


def test_what_a_mask_leaves_out_is_grey_and_outside_the_contour() -> None:
    image = textured(96, 128)
    mask = np.zeros((96, 128), np.uint8)
    mask[:, 64:] = 1
    elf = ElfRuntime(TINY, threads=1)
    plain, masked = (draw_explanation(image, elf.trace(image, mask=one)) for one in (None, mask))

    def gray(sheet: np.ndarray) -> int:
        return int((sheet == 90).all(axis=2).sum())

    assert gray(masked) > gray(plain) + 0.1 * masked.shape[0] * masked.shape[1] / 6
