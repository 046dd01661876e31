"""Oriented keypoints: angles, and descriptors that stay when the image is turned."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from elf_runtime import ElfRuntime, Features, SettingError, match
from elf_runtime.detection.scale_space import MIDDLE, OCTAVES
from elf_runtime.model import sessions
from helpers import ROOT, TINY, textured

PALACE = np.ascontiguousarray(cv2.imread(str(ROOT / "demo" / "palace.jpg"))[:400, :400])


@pytest.fixture(scope="module")
def bundled() -> ElfRuntime:
    return ElfRuntime(threads=1)


@pytest.fixture(scope="module")
def unturned(bundled: ElfRuntime) -> Features:
    return bundled.detect(PALACE, oriented=True, max_keypoints=100)


def back(points: np.ndarray, quarters: int, side: int) -> np.ndarray:
    """Where (x, y) of a square image turned counter-clockwise come from."""
    for _ in range(quarters):
        points = np.stack([side - 1 - points[:, 1], points[:, 0]], axis=1)
    return points


def difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.abs((a.astype(np.float64) - b + 180) % 360 - 180)


def right(a: Features, b: Features, matrix: np.ndarray) -> tuple[int, float]:
    """How many matches are within 3 pixels of where an affine map takes them, and which share of all."""
    first, second = match(a, b).T
    there = a.keypoints[first] @ matrix[:, :2].T + matrix[:, 2]
    good = np.linalg.norm(there - b.keypoints[second], axis=1) < 3
    return int(good.sum()), float(good.mean())


def test_without_it_nothing_changes(elf: ElfRuntime, image: np.ndarray) -> None:
    plain, oriented = elf.detect(image), elf.detect(image, oriented=True)
    assert (plain.angles == -1).all()
    np.testing.assert_array_equal(plain.descriptors, elf.detect(image, oriented=False).descriptors)
    assert ((oriented.angles >= 0) & (oriented.angles < 360)).all()
    assert len(np.unique(oriented.angles)) > len(oriented) / 2
    np.testing.assert_array_equal(oriented.scores, plain.scores)
    whole = [elf.detect(image, subpixel=False, oriented=turned) for turned in (False, True)]
    np.testing.assert_array_equal(whole[0].keypoints, whole[1].keypoints)
    assert (
        np.linalg.norm(oriented.keypoints - plain.keypoints, axis=1).max() <= MIDDLE * 2**OCTAVES / elf.params().scale
    )
    assert (plain.sizes == plain.sizes[0]).all()
    assert len(np.unique(oriented.sizes)) > len(oriented) / 2
    assert np.abs(np.log2(oriented.sizes / plain.sizes[0])).max() <= OCTAVES + 1e-6
    np.testing.assert_allclose(np.linalg.norm(oriented.descriptors, axis=1), 1, atol=1e-5)


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_an_image_turned_by_quarters_has_the_same_features(
    bundled: ElfRuntime, unturned: Features, quarters: int
) -> None:
    found = bundled.detect(np.ascontiguousarray(np.rot90(PALACE, quarters)), oriented=True, max_keypoints=100)
    distances = np.linalg.norm(back(found.keypoints, quarters, 400)[:, None] - unturned.keypoints, axis=2)
    j, i = np.nonzero(distances < 1.5)
    assert len(i) >= 50
    assert np.median(difference(found.angles[j], unturned.angles[i] - 90 * quarters)) < 2
    assert np.median((found.descriptors[j] * unturned.descriptors[i]).sum(axis=1)) > 0.9
    upright = bundled.describe(np.ascontiguousarray(np.rot90(PALACE, quarters)), found.keypoints)
    assert np.median((upright[j] * bundled.describe(PALACE, unturned.keypoints)[i]).sum(axis=1)) < 0.7


@pytest.mark.parametrize(("degrees", "most"), [(30, 0.9), (100, 0.5), (200, 0.5)])
def test_an_image_turned_by_any_angle_matches(
    bundled: ElfRuntime, unturned: Features, degrees: int, most: float
) -> None:
    matrix = cv2.getRotationMatrix2D((199.5, 199.5), degrees, 0.9)
    turned = cv2.warpAffine(PALACE, matrix, (400, 400), borderMode=cv2.BORDER_REFLECT_101)
    count, share = right(unturned, bundled.detect(turned, oriented=True, max_keypoints=100), matrix)
    assert count > 40
    assert share > 0.75
    plain = [bundled.detect(picture, max_keypoints=100) for picture in (PALACE, turned)]
    assert right(plain[0], plain[1], matrix)[0] < most * count


def test_keypoints_are_described_by_their_angles(elf: ElfRuntime, image: np.ndarray) -> None:
    params = elf.params(oriented=True, scales=(0.5, 1.0), nms_radius=3)
    found = elf.detect(image, params=params)
    assert len(np.unique(found.sizes)) > len(found) / 2
    assert (found.angles >= 0).all()
    points, _ = found.to_cv2()
    np.testing.assert_array_equal([point.angle for point in points], found.angles)
    np.testing.assert_allclose(elf.describe(image, points, params=params), found.descriptors, atol=2e-3)
    for point in points:
        point.angle = -1
    np.testing.assert_allclose(elf.describe(image, points, params=params), found.descriptors, atol=2e-3)
    for point, angle in zip(points, found.angles.tolist(), strict=True):
        point.angle = (angle + 180) % 360
    assert (elf.describe(image, points, params=params) * found.descriptors).sum(axis=1).mean() < 0.9


def test_points_get_the_orientation_that_detection_gives(elf: ElfRuntime, image: np.ndarray) -> None:
    params = elf.params(oriented=True)
    found = elf.detect(image, params=params)
    np.testing.assert_allclose(elf.describe(image, found.keypoints, params=params), found.descriptors, atol=2e-3)
    assert elf.describe(image, [], params=params).shape == (0, 8)
    outside, edge = np.array([(-50.0, 20.0)]), np.array([(0.0, 20.0)])
    described = [elf.describe(image, where, params=params.updated(scale=1.0)) for where in (outside, edge)]
    np.testing.assert_array_equal(*described)


def test_one_descriptor_does_not_depend_on_the_others(bundled: ElfRuntime, unturned: Features) -> None:
    params = bundled.params(oriented=True)
    points, rows = unturned.to_cv2()
    for count in (1, 7, 64):
        alone = bundled.describe(PALACE, points[:count], params=params)
        assert (alone * rows[:count]).sum(axis=1).min() > 0.99


def test_batches_masks_and_grids(elf: ElfRuntime, image: np.ndarray) -> None:
    batch = [image, textured(*image.shape[:2], seed=1), np.full_like(image, 9)]
    mask = np.zeros(image.shape[:2], np.uint8)
    mask[:, : image.shape[1] // 2] = 1
    settings = {"oriented": True, "grid": (2, 3), "mask_border": 0}
    found = elf.detect_batch(batch, masks=[mask, None, None], **settings)
    for features, picture, where in zip(found, batch, (mask, None, None), strict=True):
        alone = elf.detect(picture, mask=where, **settings)
        for name in ("keypoints", "angles", "descriptors"):
            np.testing.assert_allclose(getattr(features, name), getattr(alone, name), atol=2e-3)
    assert [len(features) > 0 for features in found] == [True, True, False]
    assert found[2].angles.shape == (0,)
    assert (found[0].keypoints[:, 0] < image.shape[1] / 2).all()


def test_a_model_without_descriptors_gives_angles(
    elf: ElfRuntime, image: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = elf.detect(image, oriented=True)
    monkeypatch.setattr(elf._network, "contract", replace(elf.contract, descriptors=()))
    found = elf.detect(image, oriented=True)
    assert found.descriptors.shape == (len(expected), 0)
    np.testing.assert_array_equal(found.angles, expected.angles)


def test_a_model_of_one_size_says_that_it_can_t(
    elf: ElfRuntime, image: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    fixed = replace(elf.contract.input, height=120, width=160)
    monkeypatch.setattr(elf._network, "contract", replace(elf.contract, input=fixed))
    with pytest.raises(SettingError, match=r"takes images of one size only, .* oriented"):
        elf.detect(image, oriented=True)


def test_all_patches_share_a_session(monkeypatch: pytest.MonkeyPatch) -> None:
    elf = ElfRuntime(TINY, threads=1, sizes=1)
    opened = []
    spy = sessions.open_session

    def counted(*args: object, **options: object) -> object:
        opened.append(options["dims"])
        return spy(*args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(sessions, "open_session", counted)
    elf.warmup((120, 160), params=elf.params(oriented=True))
    assert [dims["H"] for dims in opened] == [120, 256]
    for seed in range(2):
        elf.detect(textured(120, 160, seed), oriented=True)
    elf.detect(textured(90, 100), oriented=True)
    assert opened[2:] == [{}]  # for the saliency of another size
