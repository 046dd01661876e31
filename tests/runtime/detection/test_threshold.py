"""Kapur's threshold against a brute-force loop; normalisation and masks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elf_runtime import DetectionParams
from elf_runtime.detection.threshold import blurred, kapur, normalized, passing, quantile, scores_and_mask


def brute_force_kapur(counts: list[int]) -> tuple[int, dict[int, float]]:
    """The definition, in loops: (first best level or -1, entropy of every level that splits the counts)."""
    total = sum(counts)
    entropies = {}
    for level in range(len(counts) - 1):
        value = 0.0
        for part in (counts[: level + 1], counts[level + 1 :]):
            mass = sum(part)
            if mass == 0:
                break
            value -= sum(c / mass * math.log(c / mass) for c in part if c)
        else:
            entropies[level] = value
    if total == 0 or not entropies:
        return -1, entropies
    return max(entropies, key=lambda level: (entropies[level], -level)), entropies


@settings(max_examples=300, deadline=None)
@given(st.lists(st.one_of(st.just(0), st.integers(0, 5000)), min_size=2, max_size=64))
def test_kapur_maximises_the_entropy(counts: list[int]) -> None:
    level = kapur(np.array(counts))
    wanted, entropies = brute_force_kapur(counts)
    if wanted == -1:
        assert level == -1
    else:
        assert entropies[level] == pytest.approx(entropies[wanted], abs=1e-12)
        ties = [t for t, h in entropies.items() if h > entropies[wanted] - 1e-12]
        assert level in ties


def test_kapur_splits_two_clear_classes() -> None:
    counts = np.zeros(256, int)
    counts[10:20] = 100
    counts[200:210] = 50
    assert 19 <= kapur(counts) < 200


def test_kapur_of_one_occupied_bin_is_none() -> None:
    counts = np.zeros(256, int)
    counts[7] = 5
    assert kapur(counts) == -1
    assert kapur(np.zeros(256, int)) == -1


def test_an_off_by_one_level_would_be_seen() -> None:
    counts = [100, 100, 0, 1, 80, 3]
    best, entropies = brute_force_kapur(counts)
    assert entropies[best] - max(h for level, h in entropies.items() if level != best) > 1e-3
    assert kapur(np.array(counts)) == best


def test_the_mask_is_what_lies_above_the_level() -> None:
    saliency = np.zeros((40, 60), np.float32)
    saliency[10:20, 10:20] = 3.0
    saliency += np.float32(0.2)
    params = DetectionParams(denoise=(1, 1.0), threshold_blur=(1, 1.0))
    scores, mask = scores_and_mask(saliency, params)
    assert mask.sum() == 100
    assert mask[10:20, 10:20].all()
    assert scores.max() == pytest.approx(255.0)


def test_a_fixed_level_is_a_fraction_of_the_range() -> None:
    saliency = np.linspace(0, 1, 101, dtype=np.float32)[None].repeat(3, 0)
    params = DetectionParams(threshold=0.5, denoise=(1, 1.0), threshold_blur=(1, 1.0))
    assert scores_and_mask(saliency, params)[1][0].sum() == 51  # the level itself passes


def test_eight_bits_truncate_as_an_image_does() -> None:
    saliency = np.array([[0.0, 0.5, 0.999, 1.0]], np.float32)
    out = normalized(saliency, DetectionParams(quantize=True))
    assert out.dtype == np.uint8
    assert out.tolist() == [[0, 127, 254, 255]]


def test_eight_bits_saturate_beyond_the_quantile() -> None:
    saliency = np.array([[0.0, 1.0, 2.0, 3.0, 1000.0]], np.float32)
    out = normalized(saliency, DetectionParams(quantize=True, normalize=0.6))
    assert out.tolist() == [[0, 127, 255, 255, 255]]


@pytest.mark.parametrize("quantize", [False, True])
def test_an_all_zero_map_has_an_empty_mask(quantize: bool) -> None:
    scores, mask = scores_and_mask(np.zeros((32, 32), np.float32), DetectionParams(quantize=quantize))
    assert not mask.any()
    assert not scores.any()


@pytest.mark.parametrize("quantize", [False, True])
def test_a_quantile_of_zero_falls_back_to_the_maximum(quantize: bool) -> None:
    """A map that is zero but for a few pixels: its 0.95 quantile is 0, and there are keypoints all the same."""
    saliency = np.zeros((40, 60), np.float32)
    saliency[10:12, 20:22] = 3.0
    params = DetectionParams(normalize=0.95, quantize=quantize)
    assert normalized(saliency, params).max() == 255
    assert scores_and_mask(saliency, params)[1][10:12, 20:22].all()


def test_an_outlier_does_not_squash_the_histogram() -> None:
    rng = np.random.default_rng(0)
    saliency = rng.random((200, 200)).astype(np.float32)
    saliency[:100] *= 0.2
    saliency[3, 3] = 1000.0
    calm, squashed = (DetectionParams(normalize=q, denoise=(1, 1.0), threshold_blur=(1, 1.0)) for q in (0.99, 1.0))
    scores, mask = scores_and_mask(saliency, calm)
    assert mask[100:].mean() > 0.5
    assert mask[:100].mean() < 0.05
    assert scores[3, 3] == scores.max() > 255  # cut off for the level only: the maximum keeps its place
    assert scores_and_mask(saliency, squashed)[1].sum() <= 1


@pytest.mark.parametrize("q", [0.01, 0.5, 0.9, 0.99, 1.0])
@pytest.mark.parametrize("size", [1, 7, 1000])
def test_the_quantile(q: float, size: int) -> None:
    values = np.random.default_rng(1).gamma(2.0, 1.0, size).astype(np.float32)
    found = quantile(values, q)
    assert found in values
    assert (values <= found).mean() >= q
    assert (values < found).mean() < q


@pytest.mark.parametrize("threshold", ["kapur", "none", 0.0, 0.3])
@pytest.mark.parametrize("smooth", [np.uint8, np.float32])
def test_neither_zero_nor_nan_passes(threshold: str | float, smooth: type) -> None:
    scores = np.full((20, 30), 200, np.float32)
    scores[0], scores[1], scores[2:12] = 0.0, np.nan, 10.0
    levels = np.nan_to_num(scores).astype(smooth)
    mask = passing(scores, levels, DetectionParams(threshold=threshold))
    assert not mask[:2].any()
    assert mask[12:].all()


@pytest.mark.parametrize("denoise", [(1, 1.0), (3, 1.0)])
def test_only_the_level_sees_the_cut(denoise: tuple[int, float]) -> None:
    """What the quantile cuts off stays in the scores, and in the caller's map."""
    saliency = np.random.default_rng(0).random((40, 50), np.float32)
    before = saliency.copy()
    scores, smooth = blurred(saliency, DetectionParams(denoise=denoise, normalize=0.5))
    np.testing.assert_array_equal(saliency, before)
    assert scores.max() > 255.0 >= smooth.max()


@pytest.mark.parametrize("threshold", ["kapur", "none", 0.0, 0.001, 0.2, float(np.nextafter(0.2, 1)), 0.5, 1.0])
def test_eight_bit_scores_pass_as_the_same_floats_do(threshold: str | float) -> None:
    """A hair above 0.2 the level is 51 like the scores, in float32, and 52 is not the next one to pass."""
    scores = np.arange(256, dtype=np.uint8).reshape(16, 16)
    params = DetectionParams(threshold=threshold)
    found, wanted = (passing(s, scores, params) for s in (scores, scores.astype(np.float32)))
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("normalize", [1.0, 0.9])
def test_eight_bits_are_kept_up_to_the_keypoints(normalize: float) -> None:
    saliency = np.random.default_rng(0).random((40, 50), np.float32)
    params = DetectionParams(quantize=True, normalize=normalize)
    scores, smooth = blurred(saliency, params)
    assert scores.dtype == smooth.dtype == np.uint8
    floats, mask = scores_and_mask(saliency, params)
    assert floats.dtype == np.float32
    np.testing.assert_array_equal(floats, scores)
    assert mask.any()
