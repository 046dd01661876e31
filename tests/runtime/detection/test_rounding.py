"""Scores that only the rounding of floats tells apart are equal, and no keypoint moves for it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elf_runtime import DetectionParams, ModelContract
from elf_runtime.detection.detect import Seen, detect
from elf_runtime.detection.rounding import BITS, rounded
from elf_runtime.detection.working_image import prepare
from elf_runtime.results.trace import Stopwatch
from helpers import textured

PARAMS = DetectionParams(
    denoise=(5, 1.2), normalize=0.95, nms_radius=4, border=4, min_contrast=0.0, suppression="maxima", subpixel=True
)


@settings(max_examples=300, deadline=None)
@given(st.lists(st.floats(2.0**-100, 2.0**100, width=32), min_size=2, max_size=50))
def test_rounded_has_so_many_bits_and_keeps_the_order(values: list[float]) -> None:
    sorted_ = np.sort(np.array(values, np.float32))
    found = rounded(sorted_).astype(np.float64)
    mantissa = np.frexp(found)[0]
    np.testing.assert_array_equal(mantissa * 2**BITS, np.rint(mantissa * 2**BITS))
    step = 2.0 ** (np.frexp(sorted_.astype(np.float64))[1] - BITS)
    assert (np.abs(found - sorted_) <= step / 2).all()
    assert (np.diff(found) >= 0).all()


@pytest.mark.parametrize("octave", [-20, 0, 7])
def test_rounded_is_the_nearest(octave: int) -> None:
    """Of all floats of an octave."""
    floats = (np.arange(2**23, 2**24, dtype=np.int64) * 2.0 ** (octave - 23)).astype(np.float32)
    step = 2.0 ** (octave + 1 - BITS)
    found = rounded(floats).astype(np.float64)
    assert np.abs(found - floats).max() == step / 2
    assert (np.diff(found) >= 0).all()
    whole = np.arange(2 ** (BITS - 1), 2**BITS).astype(np.float32)
    np.testing.assert_array_equal(rounded(whole), whole)


def test_zero_bytes_and_whole_numbers_stay() -> None:
    assert rounded(np.zeros(3, np.float32)).tolist() == [0, 0, 0]
    bytes_ = np.arange(256, dtype=np.uint8)
    assert rounded(bytes_) is bytes_
    np.testing.assert_array_equal(rounded(bytes_.astype(np.float32)), bytes_)


def edges() -> np.ndarray:
    """What straight edges give: bars of even saliency, thin, two pixels wide, broad and slanted, and a plateau."""
    saliency = np.full((120, 160), 0.01, np.float32)
    saliency[20, 10:150] = 3.1
    saliency[30:110, 30] = 2.7
    saliency[40:42, 50:150] = 2.9
    saliency[60:70, 60:140] = 1.9
    rows = np.arange(80, 110)
    saliency[rows, rows] = 3.3
    saliency[rows, 230 - rows] = 3.7
    return saliency


def places(saliency: np.ndarray, params: DetectionParams) -> np.ndarray:
    """Of the keypoints, by row and column: only noise orders those of equal scores."""
    levels = prepare(textured(120, 160), params, None, ModelContract("net", "layer", 2.0), "net.onnx")
    seen = [Seen(image, saliency[:: round(1 / s), :: round(1 / s)].copy(), None)
            for image, s in zip(levels, params.working_scales, strict=True)]  # fmt: skip
    found = detect(seen, params, Stopwatch()).features.keypoints
    return found[np.lexsort(np.rint(found.T * 16))]


@pytest.mark.parametrize(
    "changes",
    [
        {}, {"suppression": "greedy"}, {"subpixel": False}, {"max_keypoints": 40},
        {"grid": (3, 3), "max_keypoints": 50}, {"scales": (0.5, 1.0)}, {"denoise": (3, 0.8), "nms_radius": 3},
    ],
)  # fmt: skip
def test_noise_of_a_millionth_moves_no_keypoint(changes: dict[str, object]) -> None:
    params, saliency = PARAMS.updated(threshold=0.05, **changes), edges()
    wanted = places(saliency, params)
    assert len(wanted) >= 40
    for seed in range(5):
        noise = 1 + 1e-6 * np.random.default_rng(seed).uniform(-1, 1, saliency.shape)
        found = places((saliency * noise).astype(np.float32), params)
        assert found.shape == wanted.shape
        np.testing.assert_allclose(found, wanted, atol=0.01)
