"""The database, read back by pycolmap."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elf_runtime import Features, Matches, SettingError
from elf_runtime.reconstruction import Calibration, Camera, shared_cameras, write_database
from room import K, moved_points

pycolmap = pytest.importorskip("pycolmap", reason="pycolmap, of the extra sfm, is not installed")

SIZE = (480, 640)


def features(points: np.ndarray, size: tuple[int, int] = SIZE, seed: int = 0) -> Features:
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((len(points), 8)).astype(np.float32)
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    return Features(points.astype(np.float32), np.linspace(9, 1, len(points), dtype=np.float32), rows, size)


@pytest.fixture(scope="module")
def pair() -> tuple[Features, Features]:
    """200 points in space seen from two places; the second image has the last 40 of them elsewhere."""
    first, second = moved_points(200)
    second[160:] = np.random.default_rng(1).uniform(0, 480, (40, 2))
    return features(first), features(second)


def opened(path: Path) -> Any:
    return pycolmap.Database.open(str(path))


def all_matched(count: int) -> np.ndarray:
    return np.stack([np.arange(count)] * 2, axis=1)


def test_keypoints_come_back_half_a_pixel_further(pair: tuple[Features, Features], tmp_path: Path) -> None:
    images = {"a.jpg": pair[0], "sub/with space.jpg": pair[1]}
    write_database(tmp_path / "d.db", images, {})
    with opened(tmp_path / "d.db") as database:
        read = {image.name: database.read_keypoints(image.image_id) for image in database.read_all_images()}
        assert database.num_descriptors() == 0
    assert list(read) == list(images)
    for name, found in images.items():
        assert read[name].shape == (200, 4)
        np.testing.assert_allclose(read[name][:, :2], found.keypoints + 0.5, atol=1e-3)
        np.testing.assert_array_equal(read[name][:, 2:], np.tile([1.0, 0.0], (200, 1)))


def test_a_pair_that_is_given_both_ways_round_is_refused(pair: tuple[Features, Features], tmp_path: Path) -> None:
    images, matched = {"a.jpg": pair[0], "b.jpg": pair[1]}, all_matched(200)
    with pytest.raises(SettingError, match=r"^matches of a.jpg and b.jpg are given both ways round; leave one"):
        write_database(tmp_path / "d.db", images, {("a.jpg", "b.jpg"): matched, ("b.jpg", "a.jpg"): matched})
    assert not list(tmp_path.iterdir())


def test_sizes_and_angles_are_colmap_s_scale_and_orientation(tmp_path: Path) -> None:
    points = np.array([[10, 20], [30, 40], [50, 60]])
    found = Features(*(getattr(features(points), name) for name in ("keypoints", "scores", "descriptors")), SIZE,
                     sizes=np.float32([7, 14, 28]), angles=np.float32([-1, 90, 270]))  # fmt: skip
    write_database(tmp_path / "d.db", {"a.jpg": found}, {})
    with opened(tmp_path / "d.db") as database:
        read = database.read_keypoints(database.read_all_images()[0].image_id)
    np.testing.assert_allclose(read[:, 2:], [[1, 0], [2, np.pi / 2], [4, 3 * np.pi / 2]], rtol=1e-6)


def test_matches_are_kept_and_those_that_fit_a_geometry_are_verified(
    pair: tuple[Features, Features], tmp_path: Path
) -> None:
    images, steps = {"a.jpg": pair[0], "b.jpg": pair[1]}, []
    inliers = write_database(
        tmp_path / "d.db", images, {("b.jpg", "a.jpg"): all_matched(200)}, progress=lambda *done: steps.append(done)
    )
    with opened(tmp_path / "d.db") as database:
        ids = {image.name: image.image_id for image in database.read_all_images()}
        np.testing.assert_array_equal(database.read_matches(ids["b.jpg"], ids["a.jpg"]), all_matched(200))
        verified = database.read_two_view_geometry(ids["a.jpg"], ids["b.jpg"]).inlier_matches
    kept = verified[:, 0]
    assert set(range(160)) <= set(kept.tolist())
    assert len(kept) < 175  # of 40 wrong ones few lie near their line by chance
    assert inliers == {("b.jpg", "a.jpg"): len(kept)}
    assert steps == [(1, 1)]


def test_matches_object_is_taken_as_well(pair: tuple[Features, Features], tmp_path: Path) -> None:
    a, b = features(pair[0].keypoints, seed=3), features(pair[1].keypoints, seed=3)
    found = Matches.between(a, b)
    assert len(found) == 200
    assert write_database(tmp_path / "d.db", {"a": a, "b": b}, {("a", "b"): found})["a", "b"] >= 160


def test_cameras_are_written_once_with_what_is_known(pair: tuple[Features, Features], tmp_path: Path) -> None:
    images = {"x/a.jpg": pair[0], "x/b.jpg": pair[1], "y/a.jpg": pair[0]}
    cameras = shared_cameras(dict.fromkeys(images, SIZE), focals={"y/a.jpg": 700.0})
    write_database(tmp_path / "d.db", images, {}, cameras)
    with opened(tmp_path / "d.db") as database:
        ids = {image.name: image.camera_id for image in database.read_all_images()}
        found = {camera.camera_id: camera for camera in database.read_all_cameras()}
    assert len(found) == 2
    assert ids["x/a.jpg"] == ids["x/b.jpg"] != ids["y/a.jpg"]
    guessed, known = found[ids["x/a.jpg"]], found[ids["y/a.jpg"]]
    np.testing.assert_allclose(guessed.params, [768, 320, 240, 0])
    np.testing.assert_allclose(known.params, [700, 320, 240, 0])
    assert (guessed.has_prior_focal_length, known.has_prior_focal_length) == (False, True)
    assert (guessed.width, guessed.height, guessed.model_name) == (640, 480, "SIMPLE_RADIAL")


def test_images_without_keypoints_and_pairs_without_matches_are_written(tmp_path: Path) -> None:
    empty = features(np.zeros((0, 2)))
    counts = write_database(tmp_path / "d.db", {"a": empty, "b": empty}, {("a", "b"): np.zeros((0, 2), np.int64)})
    assert counts == {("a", "b"): 0}


def test_what_does_not_belong_to_the_images_is_refused(pair: tuple[Features, Features], tmp_path: Path) -> None:
    images = dict(zip("ab", pair, strict=True))

    def refused(text: str, matches: Any, cameras: dict[str, Camera] | None = None) -> None:
        with pytest.raises(SettingError, match=text):
            write_database(tmp_path / "d.db", images, matches, cameras)
        assert list(tmp_path.iterdir()) == []

    refused("there are no features of c", {("a", "c"): all_matched(2)})
    refused("matches of a with itself", {("a", "a"): all_matched(2)})
    refused("not of their 200 and 200 features", {("a", "b"): all_matched(201)})
    refused(r"or \(K, 2\) integers, not \(3,\)", {("a", "b"): np.zeros(3)})
    small, one = Camera.guessed((10, 10)), Camera.guessed(SIZE)
    refused("b has no camera", {}, {"a": one})
    refused("b has 640x480 pixels, and its camera 10x10", {}, {"a": one, "b": small})
    wrong = {
        "COLMAP's models are SIMPLE_PINHOLE": ("FISHY", (600.0,)),
        "the parameters of PINHOLE are fx, fy, cx, cy": ("PINHOLE", (600.0,)),
        "can't be the camera of images of 640x480 pixels": ("PINHOLE", (600.0, 600.0, 3000.0, 240.0)),
    }
    for text, (model, params) in wrong.items():
        refused(text, {}, dict.fromkeys("ab", Camera(model, params, SIZE)))


def test_the_calibration_of_the_room_is_one_of_colmap_s(pair: tuple[Features, Features], tmp_path: Path) -> None:
    cameras = shared_cameras(dict.fromkeys("ab", SIZE), calibration=Calibration.of_matrix(K))
    write_database(tmp_path / "d.db", dict(zip("ab", pair, strict=True)), {}, cameras)
    with opened(tmp_path / "d.db") as database:
        (camera,) = database.read_all_cameras()
    half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    np.testing.assert_allclose(camera.calibration_matrix(), K + half)
