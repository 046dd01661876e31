"""`ElfFeature2D` in the place of OpenCV's detectors."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from elf_runtime import ElfError, ElfFeature2D, ElfRuntime, Features, ImageError, SettingError, estimate, match
from helpers import ROOT, TINY, textured

PALACE = np.asarray(cv2.imread(str(ROOT / "demo" / "palace.jpg")), np.uint8)


@pytest.fixture(scope="module")
def elf() -> ElfRuntime:
    return ElfRuntime(threads=1)


@pytest.fixture(scope="module")
def detector(elf: ElfRuntime) -> ElfFeature2D:
    return ElfFeature2D(elf, max_keypoints=200)


def places(keypoints: Any) -> np.ndarray:
    return np.float32([point.pt for point in keypoints]).reshape(-1, 2)


def test_it_finds_what_detect_finds(elf: ElfRuntime, detector: ElfFeature2D) -> None:
    wanted = elf.detect(PALACE, max_keypoints=200)
    keypoints, descriptors = detector.detectAndCompute(PALACE, None)
    np.testing.assert_array_equal(places(keypoints), wanted.keypoints)
    np.testing.assert_array_equal(descriptors, wanted.descriptors)
    np.testing.assert_array_equal(places(detector.detect(PALACE)), wanted.keypoints)
    same, rows = detector.compute(PALACE, keypoints)
    assert same == keypoints
    np.testing.assert_allclose(rows, descriptors, atol=1e-5)


@pytest.mark.parametrize("name", ["detectAndCompute", "compute", "detect"])
def test_arguments_come_in_opencv_s_order(name: str) -> None:
    orders = {
        "detect": ["image", "mask"],
        "compute": ["image", "keypoints", "descriptors"],
        "detectAndCompute": ["image", "mask", "descriptors", "useProvidedKeypoints"],
    }
    assert list(inspect.signature(getattr(ElfFeature2D, name)).parameters)[1:] == orders[name]
    for argument in orders[name]:
        assert argument in getattr(cv2.Feature2D, name).__doc__


def test_what_it_says_of_itself_is_what_a_detector_of_opencv_says(detector: ElfFeature2D) -> None:
    sift = cv2.SIFT_create()
    for name in ("defaultNorm", "descriptorType"):
        assert getattr(detector, name)() == getattr(sift, name)()
    assert detector.descriptorSize() == detector.detectAndCompute(PALACE, None)[1].shape[1] == 128
    assert detector.getDefaultName() == "Feature2D.ELF"
    assert detector.empty() is False
    assert "elf-vgg" in repr(detector)


def test_nothing_found_is_opencv_s_nothing(detector: ElfFeature2D) -> None:
    flat = np.full((64, 64), 90, np.uint8)
    sift = cv2.SIFT_create()
    assert detector.detectAndCompute(flat, None) == sift.detectAndCompute(flat, None) == ((), None)
    assert detector.detect(flat) == sift.detect(flat) == ()
    assert detector.compute(PALACE, []) == sift.compute(flat, []) == ((), None)


@pytest.mark.parametrize("channels", [None, 1, 3])
def test_masks_of_any_channels(elf: ElfRuntime, detector: ElfFeature2D, channels: int | None) -> None:
    mask = np.zeros(PALACE.shape[:2], np.uint8)
    mask[:, 300:] = 255
    given = mask if channels is None else np.zeros((*mask.shape, channels), np.uint8)
    if channels is not None:
        given[:, :, -1] = mask
    found = detector.detect(PALACE, given)
    np.testing.assert_array_equal(places(found), elf.detect(PALACE, mask=mask, max_keypoints=200).keypoints)


def test_umat_and_lists(detector: ElfFeature2D) -> None:
    pictures = [PALACE, textured(80, 96)]
    found = detector.detect([cv2.UMat(picture) for picture in pictures])
    for keypoints, picture in zip(found, pictures, strict=True):
        np.testing.assert_array_equal(places(keypoints), places(detector.detect(picture)))
    keypoints, descriptors = detector.compute(pictures, found)
    assert [len(rows) for rows in descriptors] == [len(points) for points in keypoints]
    mask = cv2.UMat(np.zeros(PALACE.shape[:2], np.uint8))
    assert detector.detectAndCompute(PALACE, mask) == ((), None)


def test_it_serves_a_matcher_of_opencv(detector: ElfFeature2D) -> None:
    (first, a), (second, b) = (detector.detectAndCompute(image, None) for image in (PALACE, PALACE[20:, 30:]))
    matches = cv2.BFMatcher(detector.defaultNorm(), crossCheck=True).match(a, b)
    assert len(matches) > 80
    moved = places(first)[[m.queryIdx for m in matches]] - places(second)[[m.trainIdx for m in matches]]
    assert (np.abs(moved - (30, 20)).max(axis=1) < 2).mean() > 0.8
    drawn = cv2.drawMatches(PALACE, first, PALACE[20:, 30:].copy(), second, matches, None)
    assert drawn.shape[1] == 2 * PALACE.shape[1] - 30


def test_settings_are_given_once(elf: ElfRuntime) -> None:
    assert len(ElfFeature2D(elf, preset="fast", max_keypoints=30).detect(PALACE)) == 30
    assert len(ElfFeature2D(TINY, max_keypoints=7).detect(textured(80, 96))) == 7
    with pytest.raises(SettingError, match="unknown preset"):
        ElfFeature2D(elf, preset="fastest")
    with pytest.raises(SettingError, match="useProvidedKeypoints"):
        ElfFeature2D(elf).detectAndCompute(PALACE, None, None, True)


def test_features_go_to_opencv_and_back(elf: ElfRuntime) -> None:
    wanted = elf.detect(PALACE, preset="multiscale", oriented=True, max_keypoints=60)
    keypoints, descriptors = wanted.to_cv2()
    back = np.random.default_rng(0).permutation(len(wanted))
    found = Features.from_cv2([keypoints[i] for i in back], descriptors[back], wanted.image_size)
    for name in ("keypoints", "scores", "descriptors", "sizes", "angles"):
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), rtol=1e-6, err_msg=name)
    assert found.image_size == wanted.image_size


def test_what_sift_finds_as_features() -> None:
    sift = cv2.SIFT_create(300)
    a, b = (
        Features.from_cv2(*sift.detectAndCompute(image, None), image.shape[:2]) for image in (PALACE, PALACE[20:, 30:])
    )
    view = estimate(a, b, "homography")
    assert view is not None
    np.testing.assert_allclose(view.matrix / view.matrix[2, 2], [[1, 0, -30], [0, 1, -20], [0, 0, 1]], atol=0.1)
    assert len(Features.from_cv2((), None, (48, 64))) == 0
    plain = Features.from_cv2([cv2.KeyPoint(3, 4, 0)], None, (48, 64))
    assert (plain.sizes[0], plain.angles[0], plain.descriptors.shape) == (1, -1, (1, 0))
    keypoints, bits = cv2.ORB_create(20).detectAndCompute(PALACE, None)
    with pytest.raises(ElfError, match=r"of 20 keypoints are \(N, D\) floats, not \(20, 32\) uint8"):
        Features.from_cv2(keypoints, bits, PALACE.shape[:2])


def test_descriptors_of_bytes(elf: ElfRuntime, detector: ElfFeature2D) -> None:
    small = ElfFeature2D(elf, max_keypoints=200, descriptor_type="uint8")
    assert (small.descriptorType(), detector.descriptorType()) == (cv2.CV_8U, cv2.CV_32F)
    assert small.defaultNorm() == cv2.NORM_L2
    keypoints, rows = small.detectAndCompute(PALACE, None)
    np.testing.assert_array_equal(rows, elf.detect(PALACE, max_keypoints=200).quantized().descriptors)
    _, again = small.compute(PALACE, keypoints)
    assert again.dtype == np.uint8
    assert np.abs(again.astype(int) - rows).max() <= 1
    flat = np.zeros((64, 64), np.uint8)
    assert small.detectAndCompute(flat, None) == ((), None)
    matcher = cv2.BFMatcher(small.defaultNorm(), crossCheck=True)
    assert all(match.queryIdx == match.trainIdx for match in matcher.match(rows, again))
    with pytest.raises(SettingError, match="descriptor_type is 'float32' or 'uint8', not 'float16'"):
        ElfFeature2D(elf, descriptor_type="float16")


def test_bytes_go_to_opencv_and_back() -> None:
    detector = ElfFeature2D(TINY, descriptor_type="uint8", threshold="none")
    image = textured(96, 128)
    keypoints, rows = detector.detectAndCompute(image, None)
    features = Features.from_cv2(keypoints, rows, image.shape[:2], quantized=True)
    np.testing.assert_array_equal(
        features.descriptors, detector.runtime.detect(image, threshold="none").quantized().descriptors
    )
    with pytest.raises(ElfError, match="say quantized=True"):
        Features.from_cv2(keypoints, rows, image.shape[:2])
    nothing = Features.from_cv2((), None, (10, 10))
    assert len(match(nothing, features)) == len(match(features, nothing)) == 0


@pytest.mark.parametrize("image", [None, np.zeros((0, 0, 3), np.uint8), np.zeros((10, 40), np.uint8)])
def test_there_is_nothing_to_find_in_what_is_too_small(image: np.ndarray | None) -> None:
    detector = ElfFeature2D(TINY)
    assert detector.detect(image) == ()
    assert detector.detectAndCompute(image, None) == ((), None)


def test_a_path_is_an_image(tmp_path: Path) -> None:
    detector, image = ElfFeature2D(TINY, threshold="none"), textured(96, 128)
    file = tmp_path / "image.png"
    cv2.imwrite(str(file), image)
    mask = np.zeros(image.shape[:2], np.uint8)
    mask[:, 40:] = 1
    for given in (None, mask):
        wanted, rows = detector.detectAndCompute(image, given)
        assert len(wanted) > 3
        for path in (file, str(file)):
            found, descriptors = detector.detectAndCompute(path, given)
            np.testing.assert_array_equal(places(found), places(wanted))
            np.testing.assert_array_equal(descriptors, rows)
            np.testing.assert_array_equal(places(detector.detect(path, given)), places(wanted))
            np.testing.assert_array_equal(places(detector.detect([path], [given])[0]), places(wanted))
            np.testing.assert_allclose(detector.compute(path, wanted)[1], rows, atol=1e-5)
    with pytest.raises(ImageError, match=r"gone\.jpg: No such file"):
        detector.detect("gone.jpg")


@pytest.mark.parametrize(
    "image",
    [
        "", b"image.png", {}, {"image": 1}, set(), 5, 0.5, True, object(), np.uint8(3), np.array(5), np.array("a.jpg"),
        np.zeros(40, np.uint8), np.zeros((2, 96, 128, 3), np.uint8), iter([]), np.zeros,
        Features.from_cv2((), None, (1, 1)),
    ],
)  # fmt: skip
def test_what_is_no_image_is_not_taken_for_a_small_one(image: Any) -> None:
    detector = ElfFeature2D(TINY)
    for detect in (detector.detect, lambda given: detector.detectAndCompute(given, None), detector.runtime.detect):
        with pytest.raises(ImageError):
            detect(image)
    with pytest.raises(ImageError):
        detector.compute(image, [cv2.KeyPoint(3, 4, 1)])


def test_lists_are_for_detect_and_compute() -> None:
    detector, image = ElfFeature2D(TINY), textured(96, 128)
    for images in ([image, image], (image,), [], [[0, 1], [2, 3]]):
        with pytest.raises(ImageError, match=r"not (list|tuple)"):
            detector.detectAndCompute(images, None)
    assert detector.detect([]) == ()


def test_a_umat_gives_a_umat() -> None:
    detector, image = ElfFeature2D(TINY, threshold="none"), textured(96, 128)
    _, plain = detector.detectAndCompute(image, None)
    keypoints, rows = detector.detectAndCompute(cv2.UMat(image), None)
    assert isinstance(rows, cv2.UMat)
    np.testing.assert_array_equal(rows.get(), plain)
    assert isinstance(detector.compute(cv2.UMat(image), keypoints)[1], cv2.UMat)


def test_arguments_that_are_mistaken() -> None:
    with pytest.raises(SettingError, match="the number of keypoints is max_keypoints=500"):
        ElfFeature2D(500)  # type: ignore[arg-type]
    detector, image = ElfFeature2D(TINY, max_keypoints=7, descriptor_type="uint8"), textured(96, 128)
    with pytest.raises(ImageError, match="1 masks for 2 images"):
        detector.detect([image, image], [None])
    with pytest.raises(ImageError, match="1 lists of keypoints for 2 images"):
        detector.compute([image, image], [[]])
    assert repr(detector).endswith(", max_keypoints=7, uint8 descriptors)")


def test_rgb() -> None:
    image = cv2.cvtColor(textured(96, 128), cv2.COLOR_BGR2RGB)
    wanted = ElfFeature2D(TINY).detect(image[:, :, ::-1])
    assert [point.pt for point in ElfFeature2D(TINY, color="rgb").detect(image)] == [point.pt for point in wanted]
