"""A corner of a room, three walls with photographs on them, seen by cameras whose poses are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from helpers import ROOT

Float = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

SIZE = (480, 640)
FOCAL = 620.0
K = np.array([[FOCAL, 0, 325.0], [0, FOCAL, 236.0], [0, 0, 1]])  # integers are the centres of pixels
SIDE = 4.0  # of a wall, in metres
_TEXELS = 1100  # of a wall's side: finer than the images see it
_PHOTOGRAPHS = ROOT / "export" / "elf_export" / "calibration_images"
_PICTURES = {  # of each wall, two by two
    "back": ("roman-colosseum", "tea-gardens", "oakland-zoo-otters", "coffee"),
    "side": ("singaporean-cityscape", "beacon-street-sunset", "chelsea", "brick"),
    "floor": ("lake-sherburne", "perched-osprey", "rocket", "camera"),
}
# A wall's corner and its two sides, in the world: z is depth, y points down.
_WALLS = {
    "back": ((-2.0, -2.0, 4.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "side": ((-2.0, -2.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
    "floor": ((-2.0, 2.0, 4.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
}


@dataclass(frozen=True)
class View:
    """A rendered image, and its camera's rotation (world to camera) and centre."""

    image: Picture
    rotation: Float
    center: Float


@cache
def wall(name: str) -> Picture:
    """Four photographs side by side, (1100, 1100, 3)."""
    half = _TEXELS // 2
    tiles = [
        cv2.resize(cv2.imread(str(_PHOTOGRAPHS / f"{picture}.jpg")), (half, half), interpolation=cv2.INTER_AREA)
        for picture in _PICTURES[name]
    ]
    return np.vstack([np.hstack(tiles[:2]), np.hstack(tiles[2:])])


def view(center: tuple[float, float, float], target: tuple[float, float, float], size: tuple[int, int] = SIZE) -> View:
    """What a camera sees that looks from `center` at `target`; twice as fine, then averaged."""
    place = np.array(center)
    ahead = np.array(target) - place
    ahead /= np.linalg.norm(ahead)
    right = np.cross((0.0, 1.0, 0.0), ahead)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    # Pixel (x, y) of the image is the average of the pixels 2x and 2x + 1 of the finer one.
    fine = np.array([[2, 0, 0.5], [0, 2, 0.5], [0, 0, 1]]) @ K
    shape = (2 * size[1], 2 * size[0])
    picture = np.zeros((shape[1], shape[0], 3), np.uint8)
    for name, (corner, along, down) in _WALLS.items():
        # Texel (u, v) lies at corner + (u + 0.5) along + (v + 0.5) down, in sides of a texel.
        texel = SIDE / _TEXELS
        axes = np.stack([np.array(along) * texel, np.array(down) * texel], axis=1)
        origin = np.array(corner) + axes @ (0.5, 0.5)
        homography = fine @ rotation @ np.column_stack([axes, origin - place])
        seen = cv2.warpPerspective(wall(name), homography, shape, flags=cv2.INTER_LINEAR)
        # Where a ray meets the wall in front of the camera.
        inside = cv2.warpPerspective(np.full((_TEXELS, _TEXELS), 255, np.uint8), homography, shape) == 255
        x, y = np.meshgrid(np.arange(shape[0]), np.arange(shape[1]))
        depth = np.linalg.inv(homography)[2] @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
        inside &= (depth > 0).reshape(inside.shape)
        picture[inside] = seen[inside]
    return View(cv2.resize(picture, size[::-1], interpolation=cv2.INTER_AREA), rotation, place)


@cache
def views() -> tuple[View, ...]:
    """Nine, 0.5 m apart, from a quarter of a circle around the corner."""
    angles = np.linspace(-0.35, 0.75, 9)
    return tuple(
        view((3.2 * np.sin(a) - 0.2, -0.3 + 0.25 * np.cos(4 * a), 2.6 - 4.2 * np.cos(a)), (-0.7, 0.4, 2.9))
        for a in angles
    )


def similarity_error(found: Float, true: Float) -> Float:
    """Distances (N,) of points to the true ones after the best similarity.  Umeyama, PAMI 1991."""
    return np.linalg.norm(moved(found, *similarity(found, true)) - true, axis=1)


def similarity(found: Float, true: Float) -> tuple[float, Float, Float]:
    """Scale, rotation (3, 3) and translation (3,) that take points (N, 3) closest to the true ones."""
    middle, goal = found.mean(axis=0), true.mean(axis=0)
    u, s, vt = np.linalg.svd((true - goal).T @ (found - middle))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ np.diag(signs) @ vt
    scale = float((s * signs).sum() / ((found - middle) ** 2).sum())
    return scale, rotation, goal - scale * rotation @ middle


def moved(points: Float, scale: float, rotation: Float, translation: Float) -> Float:
    return scale * points @ rotation.T + translation


def moved_points(count: int) -> tuple[Float, Float]:
    """Pixels (N, 2) of points in space, in two images of a camera `K` that moved and turned a little."""
    rng = np.random.default_rng(0)
    points = rng.uniform((-1.2, -0.9, 3.0), (1.2, 0.9, 6.0), (count, 3))
    rotation = cv2.Rodrigues(np.array([0.02, -0.2, 0.01]))[0]
    first, second = points @ K.T, (points @ rotation.T + (-0.2, 0.1, 0.1)) @ K.T
    return first[:, :2] / first[:, 2:], second[:, :2] / second[:, 2:]


def write_as_strecha(scene: Path, seen: Sequence[View]) -> None:
    """Views in the folder `scene` as Strecha's are published: ``images/`` and ``gt_dense_cameras/``."""
    (scene / "images").mkdir(parents=True)
    (scene / "gt_dense_cameras").mkdir()
    for n, view in enumerate(seen):
        cv2.imwrite(str(scene / "images" / f"{n:04d}.png"), view.image)
        rows = [*K, [0, 0, 0], *view.rotation.T, view.center, [SIZE[1], SIZE[0]]]
        text = "\n".join(" ".join(f"{value:.12g}" for value in row) for row in rows)
        (scene / "gt_dense_cameras" / f"{n:04d}.png.camera").write_text(text)
