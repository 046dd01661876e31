"""The sizes and angles of features: defaults, files, and cv2.KeyPoint."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elf_runtime import ElfError, Features


def arrays() -> dict[str, Any]:
    """What a file of features holds, without sizes and angles."""
    return {
        "keypoints": np.ones((3, 2), np.float32),
        "scores": np.ones(3, np.float32),
        "descriptors": np.ones((3, 4), np.float32),
        "image_size": np.array([20, 30]),
    }


def test_sizes_and_angles_come_back(tmp_path: Path) -> None:
    sizes, angles = np.array([13, 26, 52], np.float32), np.array([-1, 0, 359.5], np.float32)
    given = arrays()
    found = Features(given["keypoints"], given["scores"], given["descriptors"], (20, 30), 6, sizes, angles)
    found.save(tmp_path / "f.npz")
    for features in (found, Features.load(tmp_path / "f.npz")):
        np.testing.assert_array_equal(features.sizes, sizes)
        np.testing.assert_array_equal(features.angles, angles)
        points, _ = features.to_cv2()
        assert [point.size for point in points] == [13, 26, 52]
        assert [point.angle for point in points] == [-1, 0, 359.5]
        assert [point.octave for point in points] == [0, 1, 2]
    found.save(tmp_path / "f.csv")
    assert (tmp_path / "f.csv").read_text().splitlines()[3] == "1.000,1.000,1,52.000,359.500"


def test_a_file_without_sizes_and_angles(tmp_path: Path) -> None:
    np.savez(tmp_path / "old.npz", nms_radius=6.0, **arrays())
    found = Features.load(tmp_path / "old.npz")
    assert (found.sizes.tolist(), found.angles.tolist()) == ([13.0] * 3, [-1.0] * 3)
    assert {found.sizes.dtype, found.angles.dtype} == {np.dtype(np.float32)}


def test_octaves_are_rounded() -> None:
    sizes = np.array([21, 29, 30, 60, 10], np.float32)
    found = Features(*(np.ones(shape, np.float32) for shape in ((5, 2), 5, (5, 0))), (20, 30), sizes=sizes)
    assert [point.octave for point in found.to_cv2()[0]] == [0, 0, 1, 2, -1]


def test_sizes_and_angles_that_do_not_fit() -> None:
    given = [arrays()[name] for name in ("keypoints", "scores", "descriptors")]
    with pytest.raises(ElfError, match=r"^sizes have shape \(2,\), not \(N,\) for 3 keypoints$"):
        Features(*given, (20, 30), sizes=np.ones(2, np.float32))
    with pytest.raises(ElfError, match=r"^some angles are neither in"):
        Features(*given, (20, 30), angles=np.full(3, 360, np.float32))
