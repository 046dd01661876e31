"""Depth maps of a dataset's images, from their cameras alone, for the paper's 3D protocol."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from elf_eval.coordinates import Float, warp
from elf_eval.data import Dataset
from elf_eval.data.images import ImageRef
from elf_eval.data.plane_sweep import FloatMap, Neighbour, agreeing, sweep
from elf_eval.data.truth import Pose
from elf_eval.errors import EvalError
from elf_eval.metrics.epipolar import epipolar_distances, fundamental_matrix
from elf_eval.metrics.matching import descriptor_distances, mutual_nearest

from .progress import Progress

NEIGHBOURS = 4
WITHIN = 0.01  # of its depth: how well a pixel must agree with a neighbour's map
_LEAST_POINTS = 20  # in space, that tell between which depths to look
_MARGIN = 1.3


@dataclass(frozen=True)
class View:
    """An image at the size of the sweep, and the others that it is in pairs with, the nearest first."""

    ref: ImageRef
    grey: FloatMap
    camera: Float
    others: tuple[tuple[ImageRef, Pose], ...]


@dataclass(frozen=True)
class DepthMap:
    """A depth map, and how much is known of it.

    Attributes
    ----------
    depth : (h, w) float32
        At the size of the sweep; 0 where it is not known.
    known : float
        Share of the pixels.
    difference : float
        Median difference to a neighbour's own map, as a share of the depth, before pixels that disagree are dropped;
        NaN where no map reaches.
    """

    ref: ImageRef
    depth: FloatMap
    known: float
    difference: float


def views_of(dataset: Dataset, side: int) -> dict[ImageRef, View]:
    """The images of a dataset with poses, the longer side at most `side` pixels.

    Raises
    ------
    EvalError
        If a pair has no poses.
    """
    sized = {ref: _grey(ref, side) for ref in dataset.images()}
    others: dict[ImageRef, list[tuple[ImageRef, Pose]]] = {ref: [] for ref in sized}
    cameras: dict[ImageRef, Float] = {}
    for pair in dataset.pairs:
        a, b = pair.first, pair.second
        pose = pair.truth.at(sized[a][1], sized[b][1]).pose
        if pose is None:
            raise EvalError(f"{pair.name}: depth comes from cameras, and they are not known")
        cameras |= {a: pose.camera1, b: pose.camera2}
        back = Pose(pose.rotation.T, -pose.rotation.T @ pose.translation, pose.camera2, pose.camera1)
        others[a].append((b, pose))
        others[b].append((a, back))
    found = {}
    for ref, (grey, _) in sized.items():
        near = sorted(others[ref], key=lambda other: float(np.linalg.norm(other[1].translation)))
        apart = [other for other in near if other[1].translation.any()]
        found[ref] = View(ref, grey, cameras[ref], tuple(apart[:NEIGHBOURS]))
    return found


def _grey(ref: ImageRef, side: int) -> tuple[FloatMap, Float]:
    """(h, w) grey levels, and the matrix from pixels of the file."""
    pixels = ref.open(None).pixels
    factor = min(1.0, side / max(pixels.shape[:2]))
    size = (round(pixels.shape[1] * factor), round(pixels.shape[0] * factor))
    grey = cv2.resize(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), size, interpolation=cv2.INTER_AREA)
    sx, sy = size[0] / pixels.shape[1], size[1] / pixels.shape[0]
    return grey.astype(np.float32), np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1.0]])


def depth_maps(dataset: Dataset, side: int, planes: int, quiet: bool = False) -> list[DepthMap]:
    """A map of each image: the sweep, then only what a neighbour's map agrees with to 1 % (`WITHIN`).

    Raises
    ------
    EvalError
        As in `views_of`; if too few points are matched to tell how far away the scene is.
    """
    views = views_of(dataset, side)
    ranges = _ranges(list(views.values()), views)
    progress = Progress("depth maps", len(views), quiet=quiet)
    swept: dict[ImageRef, FloatMap] = {}
    for ref, view in views.items():
        near, far = ranges[ref]
        swept[ref] = sweep(view.grey, view.camera, [_neighbour(views, o, p) for o, p in view.others], near, far, planes)
        progress.step(ref.name)
    found = []
    for ref, view in views.items():
        others = [(swept[other], _neighbour(views, other, pose)) for other, pose in view.others]
        keep, difference = agreeing(swept[ref], view.camera, others, WITHIN)
        reached = difference[np.isfinite(difference)]
        depth = np.where(keep, swept[ref], 0.0).astype(np.float32)
        found.append(DepthMap(ref, depth, float(keep.mean()), float(np.median(reached)) if reached.size else np.nan))
    return found


def _neighbour(views: dict[ImageRef, View], ref: ImageRef, pose: Pose) -> Neighbour:
    return Neighbour(views[ref].grey, views[ref].camera, pose.rotation, pose.translation)


def _ranges(order: Sequence[View], views: dict[ImageRef, View]) -> dict[ImageRef, tuple[float, float]]:
    """Nearest and farthest depth of each image, by SIFT's matches that fit the cameras, triangulated."""
    sift = cv2.SIFT.create(2000)

    @cache
    def features(ref: ImageRef) -> tuple[Float, FloatMap]:
        points, descriptors = sift.detectAndCompute(views[ref].grey.astype(np.uint8), None)
        empty = np.zeros((0, 128), np.float32)
        return np.array([p.pt for p in points], np.float64).reshape(
            -1, 2
        ), empty if descriptors is None else descriptors

    ranges = {}
    for view in order:
        depths = [_depths(features(view.ref), features(other), pose) for other, pose in view.others]
        all_depths = np.concatenate([np.zeros(0), *depths])
        if len(all_depths) < _LEAST_POINTS:
            raise EvalError(
                f"{view.ref.name}: only {len(all_depths)} points match its neighbours; can't tell its depths"
            )
        near, far = np.quantile(all_depths, (0.01, 0.99))
        ranges[view.ref] = (float(near / _MARGIN), float(far * _MARGIN))
    return ranges


def _depths(a: tuple[Float, FloatMap], b: tuple[Float, FloatMap], pose: Pose) -> Float:
    """Depths in the first camera of matches within a pixel of their epipolar lines; x2 ~ z R x1 + t, solved for z."""
    pairs = mutual_nearest(descriptor_distances(a[1], b[1]), 0.8)
    p1, p2 = a[0][pairs[:, 0]], b[0][pairs[:, 1]]
    near = epipolar_distances(p1, p2, fundamental_matrix(pose)) <= 1.0
    x1, x2 = (np.column_stack([warp(np.linalg.inv(k), p), np.ones(near.sum())])
              for k, p in ((pose.camera1, p1[near]), (pose.camera2, p2[near])))  # fmt: skip
    # Cross products with x2: z (R x1) x x2 = -t x x2, by least squares.
    left, right = np.cross(x1 @ pose.rotation.T, x2), -np.cross(np.broadcast_to(pose.translation, x2.shape), x2)
    z = (left * right).sum(axis=1) / np.maximum((left * left).sum(axis=1), 1e-300)
    return np.asarray(z[z > 0])


def save(found: DepthMap, folder: Path) -> Path:
    """As ``STEM.depth.npy`` at the size of the image's file, each pixel with the value of the nearest one."""
    height, width = found.ref.open(None).pixels.shape[:2]
    path = (folder / found.ref.name).with_suffix(".depth.npy")
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, cv2.resize(found.depth, (width, height), interpolation=cv2.INTER_NEAREST))
    return path
