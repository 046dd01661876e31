"""The smallest scene: two images, whose points have no third one to be seen in."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime import Features
from elf_runtime.commands import reconstruct
from elf_runtime.reconstruction import read_model
from helpers import textured, turned_jpeg
from room import SIZE, K, views

pytest.importorskip("pycolmap", reason="pycolmap, of the extra sfm, is not installed")


def made(folder: Path, *options: str) -> int:
    return reconstruct.main([str(folder / "photos"), "-o", str(folder / "out"), "--threads", "1", *options])


@pytest.mark.parametrize("others", [0, 1])
def test_two_images_are_placed(others: int, tmp_path: Path) -> None:
    """Their relative pose is the true one, to half a degree in rotation and two in the direction of the move."""
    (tmp_path / "photos").mkdir()
    pair = [views()[i] for i in (3, 5)]
    for name, seen in zip("ab", pair, strict=True):
        cv2.imwrite(str(tmp_path / "photos" / f"{name}.png"), seen.image)
    if others:  # an image that has nothing in common with them
        cv2.imwrite(str(tmp_path / "photos" / "c.png"), textured(*SIZE))
    assert made(tmp_path, "--K", f"{K[0, 0]},{K[1, 1]},{K[0, 2]},{K[1, 2]}") == 0
    found = json.loads((tmp_path / "out" / "reconstruction.json").read_text())
    assert (found["registered"], found["track_length"]) == (2, 2.0)
    assert found["points"] > 500
    assert found["reprojection_error"] < 0.6
    a, b = (read_model(tmp_path / "out" / "sparse" / "0").poses[f"{name}.png"] for name in "ab")
    turned = (b.rotation @ a.rotation.T) @ (pair[1].rotation @ pair[0].rotation.T).T
    assert np.degrees(np.linalg.norm(cv2.Rodrigues(turned)[0])) < 0.5
    moves = [a.rotation @ (b.center - a.center), pair[0].rotation @ (pair[1].center - pair[0].center)]
    cosine = moves[0] @ moves[1] / np.linalg.norm(moves[0]) / np.linalg.norm(moves[1])
    assert np.degrees(np.arccos(cosine)) < 2.0


def test_a_mask_is_of_all_images(tmp_path: Path) -> None:
    """In pixels as stored: the JPEGs ask to be turned."""
    (tmp_path / "photos").mkdir()
    for name, number in (("a", 3), ("b", 5)):
        (tmp_path / "photos" / f"{name}.jpg").write_bytes(turned_jpeg(views()[number].image))
    mask = np.zeros(SIZE, np.uint8)
    mask[:, :500] = 255
    (tmp_path / "mask.jpg").write_bytes(turned_jpeg(mask))
    assert made(tmp_path, "--mask", str(tmp_path / "mask.jpg"), "-q") == 0
    for name in ("a", "b"):
        found = Features.load(tmp_path / "out" / "features" / f"{name}.jpg.npz")
        assert len(found) > 500
        assert 300 < found.keypoints[:, 0].max() < 505


def test_where_nothing_can_be_placed_only_one_line_is_said(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Not what COLMAP's own log has to say of it."""
    (tmp_path / "photos").mkdir()
    for seed, name in enumerate("ab"):
        cv2.imwrite(str(tmp_path / "photos" / f"{name}.png"), textured(120, 160, seed))
    assert made(tmp_path, "-q", "--preset", "default") == 1
    error = capfd.readouterr().err
    assert error.startswith("elf-reconstruct: error: no two images could be placed")
    assert error.count("\n") == 1
