"""ELF's detection: from the saliency maps of an image, one for each working scale, to its features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from elf_runtime.params import DetectionParams
from elf_runtime.results.features import Features
from elf_runtime.results.trace import Level, Stopwatch, Trace

from .descriptors import Array, DescriptorMap
from .grid import cell_of, passing_by_cell
from .oriented import Oriented
from .pyramid import Candidates, merged
from .refine import quadratic_peaks
from .rounding import rounded
from .select import Index, select_keypoints
from .threshold import blurred, lowest_passing, reaching
from .working_image import Levels, WorkingImage, window_sizes


@dataclass(frozen=True)
class Seen:
    """An image at one working scale, and what the network made of it.

    Attributes
    ----------
    image : WorkingImage
    saliency : (h, w) float32, >= 0
        Of the image's pixels.
    described : DescriptorMap, optional
        Without one, where keypoints aren't oriented, descriptors have no values.
    """

    image: WorkingImage
    saliency: Array
    described: DescriptorMap | None


def detect(seen: Sequence[Seen], params: DetectionParams, watch: Stopwatch, oriented: Oriented | None = None) -> Trace:
    """Threshold the saliency, keep its maxima, and read their descriptors off the map.

    Parameters
    ----------
    seen : the image at each working scale, the finest first
    watch : Stopwatch
        Gets the time of each stage.
    oriented : Oriented, optional
        What describes the keypoints in place of maps, and gives them sizes and orientations.
    """
    levels, points, scores = zip(*(_maxima(one, params, watch) for one in seen), strict=True)
    images = tuple(one.image for one in seen)
    with watch("nms"):
        level, index = _across_scales(images, points, scores, params)
    with watch("descriptors"):
        own = window_sizes(images, params.nms_radius)
        parts = []
        for number, (one, at) in enumerate(zip(seen, levels, strict=True)):
            kept = index[level == number]
            where = _placed(one.image, at, points[number][kept], params)
            if oriented is not None and params.subpixel:
                where = oriented.centres(number, where, params.border)
            sizes = np.full(len(where), own[number]) if oriented is None else oriented.sizes(number, where)
            described = _read(one.described, where) if oriented is None else np.zeros((len(where), 0), np.float32)
            parts.append((scores[number][kept], one.image.scaling.to_source(where), sizes, described))
        strength, places, sizes, descriptors = (np.concatenate(part) for part in zip(*parts, strict=True))
        order = np.argsort(np.argsort(level, kind="stable"))  # of what is kept, level by level
        order = order[np.argsort(-strength[order], kind="stable")]  # what was equal once rounded too
        strength, places, sizes, descriptors = (rows[order] for rows in (strength, places, sizes, descriptors))
        angles = np.full(len(places), -1, np.float32)
        if oriented is not None:
            angles, descriptors = oriented.described(places, sizes, angles)
    features = Features(places, strength, descriptors, images[0].scaling.source, params.nms_radius, sizes, angles)
    return Trace(features, levels, watch.seconds)


def _maxima(seen: Seen, params: DetectionParams, watch: Stopwatch) -> tuple[Level, Index, Array]:
    """One level's maps, and the keypoints at whole working pixels, (N, 2), with their scores, (N,)."""
    image = seen.image
    with watch("blur"):
        allowed = image.allowed()
        scores, smooth = blurred(seen.saliency, params, allowed)
    with watch("threshold"):
        if params.grid == (1, 1):
            level, histogram = lowest_passing(scores, smooth, params, allowed)
            mask = reaching(scores, level, allowed)
        else:
            level, histogram = np.nan, None
            mask = passing_by_cell(seen.saliency, params, allowed)
    with watch("nms"):
        found, strength = select_keypoints(scores, mask, image, params)
        # The paper's scores were of 8 bits so far.
        values, best = scores.astype(np.float32, copy=False), strength.astype(np.float32, copy=False)
    kept = smooth.astype(np.float32, copy=False) if params.grid == (1, 1) else None
    one = Level(image.scaling.scale, seen.saliency, values, mask, float(level), kept, histogram, allowed)
    return one, found, best


def _across_scales(
    images: Levels, points: Sequence[Index], scores: Sequence[Array], params: DetectionParams
) -> tuple[Index, Index]:
    """The keypoints kept, the strongest first once rounded: (K,) the level of each, its index among that level's."""
    if len(images) == 1:
        return np.zeros(len(points[0]), np.int64), np.arange(len(points[0]))
    candidates = []
    for image, found, strength in zip(images, points, scores, strict=True):
        cell, cells = cell_of(found, image.scaling.working, params.grid)
        places = image.scaling.to_source(found)
        candidates.append(Candidates(places, rounded(strength), image.scaling.scale, cell, cells))
    radius = min(params.nms_radius, max(images[0].scaling.source))
    return merged(candidates, radius, params.max_keypoints)


def _placed(image: WorkingImage, level: Level, found: Index, params: DetectionParams) -> Array:
    """(N, 2): where in the working image the maxima found at whole pixels lie."""
    if not params.subpixel:
        return found.astype(np.float32)
    return image.kept_inside(quadratic_peaks(level.scores, found), found, params.border)


def _read(described: DescriptorMap | None, points: Array) -> Array:
    """(N, D) at working pixels."""
    return np.zeros((len(points), 0), np.float32) if described is None else described.at(points)


def nothing_found(images: Levels, dim: int, params: DetectionParams, watch: Stopwatch) -> Trace:
    """What `detect` would give for an image of one colour, whose saliency is zero; descriptors are of `dim` values."""
    levels = []
    for image in images:
        zero = np.zeros(image.scaling.working, np.float32)
        levels.append(Level(image.scaling.scale, zero, zero, np.zeros(zero.shape, np.bool_), 0.0, zero))
    points, scores, descriptors = (np.zeros(shape, np.float32) for shape in ((0, 2), (0,), (0, dim)))
    features = Features(points, scores, descriptors, images[0].scaling.source, params.nms_radius)
    return Trace(features, tuple(levels), watch.seconds)
