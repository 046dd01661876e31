"""What the page holds of an image: a picture, the keypoints that there may be, and the map that they are sought in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.detection.scaling import Scaling
from elf_runtime.engine import ElfRuntime
from elf_runtime.params import DetectionParams
from elf_runtime.pictures.canvas import Picture
from elf_runtime.pictures.render import displayable
from elf_runtime.results.features import Features
from elf_runtime.results.trace import Level

LONGEST = 1600  # pixels of a picture's longer side
MOST = 3000  # keypoints of an image that have a descriptor in the page
WIDEST = 40  # nms_radius that can be tried, in pixels of the source image


@dataclass(frozen=True, eq=False)
class ScoreMap:
    """The map in which the page seeks keypoints, and the settings that it begins with.

    Attributes
    ----------
    scores : (h, w) uint16
        The denoised saliency in units of `step`, a power of two, so that whole levels are exact.
    permitted : (h, w) bool
        Where the border, a mask and the least contrast allow keypoints.
    level : float
        The lowest score that passes.
    radii : tuple of int
        The suppression window's radius in working pixels for each nms_radius from 0 to `WIDEST`, or the image's own.
    params : DetectionParams
    """

    scores: npt.NDArray[np.uint16]
    step: float
    permitted: npt.NDArray[np.bool_]
    level: float
    radii: tuple[int, ...]
    params: DetectionParams


@dataclass(frozen=True, eq=False)
class Shown:
    """An image of the page.

    Attributes
    ----------
    name : str
    picture : (h, w, 3) uint8, optional
        BGR, at most `LONGEST` pixels; None where the image is not at hand.
    features : Features
        In uint8, as `quantized`: with a map those found and, up to `MOST`, those that other settings may let through;
        without one those found.
    map : ScoreMap, optional
    note : str
        What the page can't do for this image, and why.
    """

    name: str
    picture: Picture | None
    features: Features
    map: ScoreMap | None = None
    note: str = ""


def detected(
    elf: ElfRuntime,
    name: str,
    pixels: npt.NDArray[Any],
    params: DetectionParams,
    descriptor: str | None = None,
    mask: npt.NDArray[np.bool_] | None = None,
) -> Shown:
    """An image with its map, or, where there are several working scales or a grid, with the keypoints only."""
    trace = elf.trace(pixels, mask=mask, params=params, descriptor=descriptor)
    if len(trace.levels) != 1 or params.grid != (1, 1):
        why = {0: "a file that gives keypoints itself", 1: "a grid"}.get(len(trace.levels), "several working scales")
        note = f"{why}: the keypoints are those of elf-detect, and only level and count can be changed"
        return Shown(name, small(pixels), trace.features.quantized(), None, note)
    # A keypoint is a maximum of its 3x3 pixels, whatever the radius, but for the slopes that "greedy" may take.
    loose = params.updated(threshold="none", nms_radius=1, max_keypoints=MOST, oriented=False)
    every = elf.trace(pixels, mask=mask, params=loose, descriptor=descriptor)
    candidates = trace.features if params.oriented else united(trace.features, every.features)
    own = score_map(trace.levels[0], every.levels[0].mask, trace.features.image_size, params)
    note = "oriented: only the keypoints of its own settings have descriptors" if params.oriented else ""
    return Shown(name, small(pixels), candidates.quantized(), own, note)


def united(first: Features, second: Features) -> Features:
    """The features of both, those at one place once, the strongest first."""
    known = {tuple(place) for place in first.keypoints.tolist()}
    added = second[np.array([tuple(place) not in known for place in second.keypoints.tolist()], np.bool_)]
    points, scores, rows, angles = (
        np.concatenate([getattr(first, name), getattr(added, name)])
        for name in ("keypoints", "scores", "descriptors", "angles")
    )
    both = Features(points, scores, rows, first.image_size, first.nms_radius, angles=angles)
    return both.strongest(len(both))


def score_map(
    level: Level, passed: npt.NDArray[np.bool_], source: tuple[int, int], params: DetectionParams
) -> ScoreMap:
    """The map of a level; `passed` is where keypoints may be, whatever the level is."""
    scaling = Scaling(source, level.scores.shape, level.scale)
    rows, columns = scaling.margin(params.border)
    height, width = level.scores.shape
    permitted = np.zeros(passed.shape, np.bool_)
    inside = (slice(rows, height - rows), slice(columns, width - columns))
    permitted[inside] = passed[inside]
    step = quantization_step(float(level.scores.max()))
    scores = np.rint(level.scores / np.float32(step)).astype(np.uint16)
    radii = tuple(scaling.radius(pixels) for pixels in range(max(WIDEST, params.nms_radius) + 1))
    return ScoreMap(scores, step, permitted, level.threshold, radii, params)


def quantization_step(top: float) -> float:
    """The smallest power of two of which `top` is at most 65535."""
    return float(2.0 ** np.ceil(np.log2(max(top, 2.0**-100) / 65535)))


def small(pixels: npt.NDArray[Any]) -> Picture:
    """The image as BGR uint8, shrunk to `LONGEST` pixels."""
    picture = displayable(pixels)
    height, width = picture.shape[:2]
    factor = LONGEST / max(height, width)
    if factor >= 1:
        return picture
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
