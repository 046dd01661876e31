"""Detection at several working scales: what `detect` makes of each scale's own keypoints."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from elf_runtime import ElfRuntime, Features, match
from helpers import ROOT, TINY, textured

SCALES = (0.3, 0.6, 1.2)


@pytest.fixture
def bundled() -> ElfRuntime:
    return ElfRuntime(threads=1)


def own_scale(found: Features) -> np.ndarray:
    """The working scale of each keypoint, by its size."""
    return np.asarray(SCALES[-1] * found.sizes.min() / found.sizes)


def rows(points: np.ndarray) -> set[tuple[float, ...]]:
    return set(map(tuple, points.tolist()))


def test_keypoints_are_those_of_each_scale_alone(elf: ElfRuntime, image: np.ndarray) -> None:
    settings = {"threshold": "none", "nms_radius": 3, "border": 4}
    found = elf.detect(image, scales=SCALES, **settings)
    assert set(found.sizes.tolist()) == {7.0, 14.0, 28.0}
    assert (np.diff(found.scores) <= 0).all()
    for scale in SCALES:
        alone = elf.detect(image, scale=scale, **settings)
        mine = np.isclose(own_scale(found), scale)
        assert 3 < mine.sum() < len(alone)
        assert rows(found.keypoints[mine]) <= rows(alone.keypoints)
        described = elf.describe(image, found.keypoints[mine], scale=scale)
        np.testing.assert_allclose(described, found.descriptors[mine], atol=1e-5)
    a, b = np.nonzero(np.triu(np.abs(found.keypoints[:, None] - found.keypoints).max(axis=2) <= 2.5, 1))
    assert (found.sizes[a] == found.sizes[b]).all()  # none beside a keypoint of another scale


def test_the_limit_holds_and_each_scale_has_its_share(bundled: ElfRuntime) -> None:
    found = bundled.detect(textured(240, 320), preset="multiscale", max_keypoints=70)
    assert len(found) == 70
    sizes, counts = np.unique(found.sizes, return_counts=True)
    assert sizes.tolist() == [7, 14, 28]
    assert (counts >= (40, 20, 10)).all()


def test_one_scale_of_several_is_that_scale(elf: ElfRuntime, image: np.ndarray) -> None:
    a, b = elf.trace(image, scales=(0.6,)), elf.trace(image, scale=0.6)
    for name in ("keypoints", "scores", "descriptors", "sizes"):
        np.testing.assert_array_equal(getattr(a.features, name), getattr(b.features, name))
    assert [level.scale for level in b.levels] == [0.6]


def test_a_trace_has_all_levels_the_finest_first(elf: ElfRuntime, image: np.ndarray) -> None:
    trace = elf.trace(image, scales=SCALES)
    assert [level.scale for level in trace.levels] == [1.2, 0.6, 0.3]
    assert [level.saliency.shape for level in trace.levels] == [(144, 192), (72, 96), (36, 48)]
    for name in ("saliency", "scores", "mask"):
        assert getattr(trace, name) is getattr(trace.levels[0], name)
    for level in trace.levels:
        np.testing.assert_allclose(level.saliency, elf.trace(image, scale=level.scale).saliency, rtol=1e-3, atol=1e-6)
    np.testing.assert_array_equal(
        elf.saliency(image, params=elf.params(scales=SCALES)), elf.saliency(image, scale=SCALES[-1])
    )


def test_keypoints_are_described_at_the_scale_of_their_size(elf: ElfRuntime, image: np.ndarray) -> None:
    params = elf.params(scales=SCALES, nms_radius=3)
    found = elf.detect(image, params=params)
    points, _ = found.to_cv2()
    np.testing.assert_allclose(elf.describe(image, points, params=params), found.descriptors, atol=1e-5)
    for point in points:
        point.size *= 1.3  # still nearest to its own
    np.testing.assert_allclose(elf.describe(image, points, params=params), found.descriptors, atol=1e-5)
    at_finest = elf.describe(image, found.keypoints, scale=SCALES[-1])
    np.testing.assert_allclose(elf.describe(image, found.keypoints, params=params), at_finest, atol=1e-5)
    small = [cv2.KeyPoint(float(x), float(y), 0.0) for x, y in found.keypoints]
    np.testing.assert_allclose(elf.describe(image, small, params=params), at_finest, atol=1e-5)
    assert elf.describe(image, [], params=params).shape == elf.describe(image, np.zeros((2, 0)), params=params).shape


def test_a_batch_has_each_image_s_keypoints(elf: ElfRuntime) -> None:
    batch = [textured(120, 160), textured(120, 160, seed=1), np.full((120, 160, 3), 9, np.uint8), textured(96, 128)]
    masks = [None, np.tri(120, 160, dtype=bool), None, None]
    settings = {"scales": SCALES, "nms_radius": 3, "border": 4}
    found = elf.detect_batch(batch, masks=masks, **settings)
    for features, image, mask in zip(found, batch, masks, strict=True):
        alone = elf.detect(image, mask=mask, **settings)
        np.testing.assert_allclose(features.keypoints, alone.keypoints, atol=1e-3)
        np.testing.assert_array_equal(features.sizes, alone.sizes)
    assert len(found[2]) == 0
    assert len(elf.trace(batch[2], **settings).levels) == 3


def test_mask_and_border_hold_at_every_scale(elf: ElfRuntime, image: np.ndarray) -> None:
    mask = np.zeros(image.shape[:2], bool)
    mask[:, :90] = True
    found = elf.detect(image, mask=mask, mask_border=5, border=12, scales=SCALES, nms_radius=2, subpixel=True)
    assert len(set(found.sizes.tolist())) == 3
    x, y = found.keypoints.T
    assert (x >= 12).all()
    assert (x < 90 - 5 + 0.5).all()
    assert (y >= 12).all()
    assert (y <= 107).all()


def test_a_grid_spreads_the_keypoints_of_all_scales(bundled: ElfRuntime) -> None:
    image = textured(240, 320)
    image[:, 160:] = image[:, 160:] // 6 + 100  # fainter
    right = []
    for grid in ((1, 1), (1, 2)):
        found = bundled.detect(image, preset="multiscale", max_keypoints=60, grid=grid)
        assert len(found) == 60
        right.append(int((found.keypoints[:, 0] >= 160).sum()))
    assert right[0] < 15
    assert right[1] >= 25


def test_scales_of_a_small_image_that_come_to_one_size_are_one(elf: ElfRuntime) -> None:
    image = textured(40, 48)
    least = elf.contract.input.min_size
    trace = elf.trace(image, scales=(0.1, 0.2, 1.0), border=2, nms_radius=2)
    assert [level.saliency.shape for level in trace.levels] == [(40, 48), (least, round(48 * least / 40))]
    alone = elf.detect(image, scale=0.1, border=2, nms_radius=2)
    np.testing.assert_array_equal(
        elf.detect(image, scales=(0.1, 0.2), border=2, nms_radius=2).keypoints, alone.keypoints
    )
    assert set(trace.features.sizes.tolist()) <= {5.0, 5.0 * 40 / least}


def test_lengths_beyond_the_image_are_the_image(elf: ElfRuntime, image: np.ndarray) -> None:
    found = elf.detect(image, scales=SCALES, nms_radius=10**400, border=0)
    assert len(found) == 1
    assert found.sizes[0] >= 2 * 160 + 1


def test_an_image_of_twice_the_size_has_its_keypoints_an_octave_up(bundled: ElfRuntime) -> None:
    image = cv2.imread(str(ROOT / "demo" / "palace.jpg"))
    small = cv2.resize(image, (320, 214), interpolation=cv2.INTER_AREA)
    large = cv2.resize(small, (640, 428), interpolation=cv2.INTER_CUBIC)
    a, b = (bundled.detect(picture, preset="multiscale") for picture in (small, large))
    pairs = match(a, b)
    away = (a.keypoints[pairs[:, 0]] + 0.5) * 2 - 0.5 - b.keypoints[pairs[:, 1]]
    right = pairs[np.abs(away).max(axis=1) < 3]
    ratio = b.sizes[right[:, 1]] / a.sizes[right[:, 0]]
    assert len(right) > 60
    assert (ratio == 2).mean() > 0.8
    octaves = [[point.octave for point in found.to_cv2()[0]] for found in (a, b)]
    assert set(octaves[0]) == set(octaves[1]) == {0, 1, 2}
    np.testing.assert_array_equal(
        np.array(octaves[1])[right[:, 1]] - np.array(octaves[0])[right[:, 0]], np.log2(ratio).astype(int)
    )


def test_a_detector_without_descriptors(monkeypatch: pytest.MonkeyPatch, image: np.ndarray) -> None:
    elf = ElfRuntime(TINY, threads=1)
    monkeypatch.setattr(elf._network, "contract", replace(elf.contract, descriptors=()))
    found = elf.detect(image, scales=SCALES)
    assert found.descriptors.shape == (len(found), 0)
    assert len(found) > 3


def test_a_contract_holds_the_scales(elf: ElfRuntime) -> None:
    several = replace(elf.contract, detection=elf.contract.detection.updated(scales=SCALES))
    assert type(several).from_metadata(several.to_metadata(), "m.onnx").detection.scales == SCALES
    assert "scales" not in elf.contract.to_metadata()["elf.detection"]  # as of files that are older than the setting
