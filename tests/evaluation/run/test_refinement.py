"""Matches that are refined by the images, of any detector."""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np
import pytest

from elf_eval.data.images import ImageRef
from elf_eval.data.truth import WorkingTruth
from elf_eval.features import ImageFeatures, LocalFeatures
from elf_eval.methods import open_method
from elf_eval.metrics.family import FeaturePair
from elf_eval.protocol import Protocol
from elf_eval.run.cache import extract
from elf_eval.run.refinement import as_runtime, refined_points
from helpers import textured


@pytest.mark.parametrize("method", ["sift", "elf"])
def test_each_refined_match_of_a_detector_is_nearer_to_the_truth(method, tmp_path):
    """By the median over the matches, of a shift by parts of a pixel."""
    image = cv2.GaussianBlur(textured(240, 320, seed=5), (0, 0), 1.0)
    matrix = np.array([[1, 0, 73 / 32], [0, 1, -51 / 32]])
    images = (image, cv2.warpAffine(image, matrix, (320, 240), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT))
    found = []
    for number, pixels in enumerate(images):
        cv2.imwrite(str(tmp_path / f"{number}.png"), pixels)
        found.append(
            extract(open_method(method, 1), ImageRef("a.png", tmp_path / f"{number}.png"), Protocol(size=None))
        )
    errors = []
    for refine in (False, True):
        pair = FeaturePair(
            *found,
            WorkingTruth(),
            Protocol(size=None, ratio=0.9, refine=refine),
            partial(refined_points, *found, images),
        )
        first, second = pair.matched_points
        errors.append(np.median(np.linalg.norm(second - first - matrix[:, 2], axis=1)))
    assert errors[1] < 0.05
    assert errors[1] < 0.7 * errors[0]


def test_any_detector_s_sizes_and_angles_become_the_runtime_s():
    found = LocalFeatures.build(np.zeros((5, 2)), 1.0, None, [0, 3, -1, 5, 7], [-1, 360, -90, 725, 10])
    runtime = as_runtime(ImageFeatures(found, (640, 480), np.eye(3), 0.0))
    assert runtime.image_size == (480, 640)
    assert runtime.sizes.tolist() == [1, 3, 1, 5, 7]
    assert runtime.angles.tolist() == [-1, 0, -1, 5, 10]
