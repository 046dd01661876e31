"""All metrics of a pair: what each kind of ground truth and of features allows."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest
from scenes import SMALL

from elf_eval.coordinates import warp
from elf_eval.data import open_dataset
from elf_eval.data.truth import Calibrated, Homography
from elf_eval.errors import EvalError
from elf_eval.features import ImageFeatures, LocalFeatures
from elf_eval.methods import open_method
from elf_eval.metrics.pair import pair_metrics
from elf_eval.protocol import Protocol
from elf_eval.run.cache import extract
from elf_eval.run.refinement import refined_points
from helpers import textured

PROTOCOL = Protocol()


K = np.array([[500.0, 0, 320], [0, 500.0, 240], [0, 0, 1]])


SIZE = (640, 480)


def extracted(points, descriptors):
    features = LocalFeatures.build(points, np.arange(len(points), 0, -1), descriptors)
    return ImageFeatures(features, SIZE, np.eye(3), 0.0)


def flat(matrix):
    return tuple(np.asarray(matrix, float).ravel().tolist())


def calibrated():
    """The transform to a camera that is moved and turned by 5 degrees, and the ground truth."""
    a = np.radians(5)
    turn = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = turn, [-1.0, 0.1, 0.2]
    return transform, Calibrated(flat(K), flat(K), flat(transform))


@pytest.fixture
def cloud(rng):
    """Points of both images of a cloud, with descriptors that tell them apart."""
    transform, truth = calibrated()
    world = rng.uniform([-3, -2, 7], [3, 2, 14], (100, 3))
    there = world @ transform[:3, :3].T + transform[:3, 3]
    p1, p2 = (warp(K, x[:, :2] / x[:, 2:]) for x in (world, there))
    return extracted(p1, np.eye(100)), extracted(p2, np.eye(100)), truth


def test_a_calibrated_pair_without_depth_has_the_pose_alone(cloud):
    record = pair_metrics(*cloud, PROTOCOL)
    assert record["matches"] == 100
    assert record["pose_error"] < 1.0
    assert record["pose_auc@5"] == pytest.approx(1 - record["pose_error"] / 5)
    assert record["pose_inliers"] > 90
    assert not {"rep", "ms", "mma@3", "h_error"} & record.keys()


def test_matches_of_a_true_pair_lie_on_their_lines(cloud):
    record = pair_metrics(*cloud, PROTOCOL)
    assert (record["epi_right@1"], record["epi_right@3"]) == (100, 100)
    assert record["epi@1"] == record["epi@3"] == 1.0
    assert record["epi_median"] < 1e-3  # keypoints are float32


def test_cameras_of_one_centre_have_no_lines(cloud):
    first, second, truth = cloud
    turned = np.reshape(truth.transform, (4, 4)).copy()
    turned[:3, 3] = 0.0
    record = pair_metrics(first, second, replace(truth, transform=flat(turned)), PROTOCOL)
    assert not [name for name in record if name.startswith("epi")]
    assert "pose_error" in record


def test_the_ratio_is_for_the_matches_and_not_for_the_papers_scores():
    """Two of four descriptors are nearly alike."""
    points = [[100.0, 100.0], [200.0, 100.0], [150.0, 300.0], [400.0, 280.0]]
    rows = np.array([[1, 0, 0], [0.999, 0.01, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    first, second = extracted(points, rows), extracted(points, rows + np.float32([0, 0, 0.008]))
    plain = pair_metrics(first, second, Homography(), PROTOCOL)
    strict = pair_metrics(first, second, Homography(), replace(PROTOCOL, ratio=0.5))
    assert (plain["matches"], strict["matches"]) == (4, 2)
    assert plain["ms"] == strict["ms"] == 1.0
    assert (plain["h_error"], strict["h_error"]) == (pytest.approx(0.0, abs=1e-6), None)


def test_a_calibrated_pair_with_depth_has_the_papers_metrics_too(tmp_path):
    _, without = calibrated()
    np.save(tmp_path / "wall.npy", np.full((480, 640), 10.0, np.float32))  # near enough for both cameras
    wall = tmp_path / "wall.npy"
    truth = Calibrated(without.intrinsics1, without.intrinsics2, without.transform, wall, wall)
    grid = np.stack(np.meshgrid(np.arange(200.0, 440, 30), np.arange(150.0, 330, 30)), axis=-1).reshape(-1, 2)
    there = truth.at(np.eye(3), np.eye(3)).forward(grid)
    assert np.isfinite(there).all()
    record = pair_metrics(extracted(grid, np.eye(len(grid))), extracted(there, np.eye(len(grid))), truth, PROTOCOL)
    assert record["rep"] == record["ms"] == record["mma@1"] == 1.0
    assert "h_error" not in record


def test_no_keypoints_are_zeros_and_no_estimate():
    nothing = extracted(np.zeros((0, 2)), np.zeros((0, 8), np.float32))
    record = pair_metrics(nothing, nothing, Homography(), PROTOCOL)
    assert record["rep"] == record["ms"] == record["mma@10"] == record["h_auc@5"] == 0.0
    assert record["h_error"] is None
    assert record["n1"] == record["matches"] == record["h_inliers"] == 0


def test_a_detector_alone_has_no_matching_metrics():
    alone = extracted([[10.0, 10.0], [50.0, 60.0]], None)
    record = pair_metrics(alone, alone, Homography(), PROTOCOL)
    assert record == {"n1": 2, "n2": 2, "seen1": 2, "seen2": 2, "rep": 1.0}


def test_descriptors_of_two_kinds_are_refused():
    points = [[10.0, 10.0]]
    floats, bits = (
        extracted(points, np.ones((1, 8), np.float32)),
        extracted(points, np.ones((1, 8), np.uint8)),
    )
    with pytest.raises(EvalError, match="can't be compared"):
        pair_metrics(floats, bits, Homography(), PROTOCOL)


@pytest.mark.parametrize("which", ["first", "second"])
def test_intrinsics_of_another_size_of_the_image_are_refused(cloud, which):
    """Images reduced to a quarter of what the cameras are for."""
    first, second, truth = cloud
    large = np.diag([4.0, 4.0, 1.0]) @ K
    wrong = replace(truth, **{"intrinsics1" if which == "first" else "intrinsics2": flat(large)})
    with pytest.raises(EvalError, match=rf"the {which} camera's principal point \(1280, 960\) lies outside"):
        pair_metrics(first, second, wrong, PROTOCOL)


def test_all_metrics_of_a_pair_of_the_same_image(hpatches_folder):
    ref = open_dataset(f"hpatches:{hpatches_folder}").pairs[0].first
    pair = open_dataset(f"hpatches:{hpatches_folder}").pairs[0]
    one = extract(open_method("orb"), ref, SMALL)
    record = pair_metrics(one, one, pair.truth, SMALL)
    assert record["rep"] == record["mma@1"] == record["mma@10"] == 1.0
    assert record["h_auc@1"] > 0.999
    assert record["h_inliers"] == record["matches"] > 10


def by(first, second, images):
    return partial(refined_points, first, second, images)


def test_refined_matches_are_nearer_to_the_truth_and_no_score_of_the_paper_s_changes(rng):
    """Keypoints of a shifted image that are off by a pixel; the shift is a multiple of OpenCV's steps of 1/32."""
    shift = np.array([2.28125, -1.59375])
    image = cv2.GaussianBlur(textured(SIZE[1], SIZE[0]), (0, 0), 1.0)
    matrix = np.array([[1, 0, shift[0]], [0, 1, shift[1]]])
    images = (image, cv2.warpAffine(image, matrix, SIZE, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT))
    points = rng.uniform((40, 40), (600, 440), (80, 2))
    first, second = extracted(points, np.eye(80)), extracted(points + shift + rng.normal(0, 0.8, (80, 2)), np.eye(80))
    truth = Homography(flat([[1, 0, shift[0]], [0, 1, shift[1]], [0, 0, 1]]))
    plain = pair_metrics(first, second, truth, PROTOCOL)
    refined = pair_metrics(first, second, truth, replace(PROTOCOL, refine=True), by(first, second, images))
    assert plain["mma@1"] < 0.7 < 0.95 < refined["mma@1"]
    assert refined["h_error"] < 0.1 < plain["h_error"]
    kept = ("n1", "n2", "seen1", "seen2", "rep", "ms", "matches")
    assert [refined[name] for name in kept] == [plain[name] for name in kept]


def test_refined_matches_of_cameras_are_nearer_to_their_lines(rng):
    """A camera that moves along the rows of a fronto-parallel wall, which shifts in the image by 3 pixels."""
    image = cv2.GaussianBlur(textured(SIZE[1], SIZE[0]), (0, 0), 1.0)
    images = (image, np.roll(image, 3, axis=1))
    transform = np.eye(4)
    transform[0, 3] = 1.0
    points = rng.uniform((40, 40), (600, 440), (80, 2))
    there = points + np.array([3, 0]) + rng.normal(0, 0.8, (80, 2))
    first, second = extracted(points, np.eye(80)), extracted(there, np.eye(80))
    truth = Calibrated(flat(K), flat(K), flat(transform))
    plain = pair_metrics(first, second, truth, PROTOCOL)
    refined = pair_metrics(first, second, truth, replace(PROTOCOL, refine=True), by(first, second, images))
    assert refined["epi_median"] < 0.1 < plain["epi_median"]
    assert refined["epi@1"] > plain["epi@1"]
    assert refined["epi_ms"] == plain["epi_ms"]
