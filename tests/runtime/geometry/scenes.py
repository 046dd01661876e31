"""Points that two views see of a plane and of a scene with depth, and features that match them."""

from __future__ import annotations

import cv2
import numpy as np

from elf_runtime import Features

HOMOGRAPHY = np.array([[0.9, 0.12, 15.0], [-0.08, 1.05, -9.0], [1e-4, -5e-5, 1.0]])
TURN = cv2.Rodrigues(np.array([0.02, 0.1, -0.03]))[0]
ALONG = np.array([-1.0, 0.1, 0.2]) / np.linalg.norm([-1.0, 0.1, 0.2])
K1 = np.array([[520.0, 0.0, 310.0], [0.0, 500.0, 250.0], [0.0, 0.0, 1.0]])
K2 = np.array([[780.0, 0.0, 330.0], [0.0, 770.0, 230.0], [0.0, 0.0, 1.0]])
KINDS = ("homography", "fundamental", "essential")


def scene_points(count: int, wrong: int, second_camera: np.ndarray = K1) -> tuple[np.ndarray, np.ndarray]:
    """Where two cameras see points of a scene with depth, float64; the last `wrong` are seen anywhere in the second."""
    rng = np.random.default_rng(1)
    scene = rng.uniform((-3, -2, 6), (3, 2, 14), (count, 3))
    seen = (scene @ K1.T, (scene @ TURN.T + ALONG) @ second_camera.T)
    first, second = (view[:, :2] / view[:, 2:] for view in seen)
    second[count - wrong :] = rng.uniform(0, (640, 480), (wrong, 2))
    return first, second


def plane_points(count: int, wrong: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    first = rng.uniform(0, (640, 480), (count, 2))
    second = cv2.perspectiveTransform(first[None], HOMOGRAPHY)[0]
    second[count - wrong :] = rng.uniform(0, (640, 480), (wrong, 2))
    return first, second


def described(first: np.ndarray, second: np.ndarray) -> tuple[Features, Features]:
    """Features whose descriptors match them in the order given, the second side's reversed."""
    rows = np.random.default_rng(2).standard_normal((len(first), 32))
    rows = (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)
    scores = np.ones(len(first), np.float32)
    return (
        Features(first.astype(np.float32), scores, rows, (480, 640)),
        Features(second[::-1].astype(np.float32), scores, rows[::-1].copy(), (480, 640)),
    )
