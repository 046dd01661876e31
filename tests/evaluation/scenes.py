"""Synthetic photographs and datasets."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from elf_eval.protocol import Protocol

SIZE = (200, 160)  # width, height


def photograph(seed: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """(H, W, 3) uint8: rectangles and discs over a soft ground, with corners to find."""
    rng = np.random.default_rng(seed)
    width, height = size
    ground = cv2.GaussianBlur(rng.integers(0, 256, (height, width, 3), np.uint8), (31, 31), 8)
    for _ in range(40):
        x, y = int(rng.integers(0, width)), int(rng.integers(0, height))
        w, h = (int(v) for v in rng.integers(5, 40, 2))
        colour = tuple(int(c) for c in rng.integers(0, 256, 3))
        if rng.random() < 0.5:
            cv2.rectangle(ground, (x, y), (x + w, y + h), colour, -1)
        else:
            cv2.circle(ground, (x, y), w // 2, colour, -1)
    return ground


def write_hpatches(root: Path, scenes: list[str]) -> None:
    """Scenes of three images: image 1, the same darker, and a homography of it."""
    matrix = np.array([[0.95, 0.08, 4.0], [-0.06, 1.02, 3.0], [1e-4, -5e-5, 1.0]])
    for number, name in enumerate(scenes):
        folder = root / name
        folder.mkdir()
        first = photograph(number)
        cv2.imwrite(str(folder / "1.png"), first)
        cv2.imwrite(str(folder / "2.png"), (first * 0.7).astype(np.uint8))
        cv2.imwrite(str(folder / "3.png"), cv2.warpPerspective(first, matrix, SIZE))
        np.savetxt(folder / "H_1_2", np.eye(3))
        np.savetxt(folder / "H_1_3", matrix)


WORKING = (160, 120)


def between(pair, size=WORKING):
    return pair.truth.at(pair.first.open(size).to_working, pair.second.open(size).to_working)


def write_strecha(folder, depth):
    """A wall 5 units in front of two cameras, the second one unit to the right."""
    folder.mkdir()
    for n in range(2):
        cv2.imwrite(str(folder / f"000{n}.png"), photograph(n))
        camera = f"100 0 99.5\n0 100 79.5\n0 0 1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n{n} 0 0\n{SIZE[0]} {SIZE[1]}\n"
        (folder / f"000{n}.png.camera").write_text(camera)
        if depth:
            np.save(folder / f"000{n}.depth.npy", np.full((SIZE[1], SIZE[0]), 5.0, np.float32))


def pairs_line(turns=0):
    k = "100 0 99.5 0 100 79.5 0 0 1"
    return f"a.png b.png {turns} 0 {k} {k} 1 0 0 1 0 1 0 0 0 0 1 0 0 0 0 1\n"


def check(found, size=SIZE):
    """What every method promises."""
    assert (np.diff(found.scores) <= 0).all()
    assert found.keypoints.dtype == np.float32
    assert (found.keypoints >= -0.5).all()
    assert (found.keypoints < np.array(size)).all()
    assert len(found.descriptors) == len(found)


def same(a, b):
    return [vars(p) for p in a.pairs] == [vars(p) for p in b.pairs]


SMALL = Protocol(size=(160, 120), max_keypoints=60)
