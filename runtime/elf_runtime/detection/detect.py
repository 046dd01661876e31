"""ELF's detection: from the saliency maps of an image, one for each working scale, to its features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from elf_runtime.params import DetectionParams
from elf_runtime.results.features import Features, window_size
from elf_runtime.results.trace import Level, Stopwatch, Trace

from .descriptors import Array, DescriptorMap
from .grid import cell_of, passing_by_cell
from .pyramid import Candidates, merged
from .refine import quadratic_peaks
from .select import Index, select_keypoints
from .threshold import blurred, lowest_passing, reaching
from .upright import UprightPatches
from .working_image import Levels, WorkingImage


@dataclass(frozen=True)
class Seen:
    """An image at one working scale, and what the network made of it.

    Attributes
    ----------
    image : WorkingImage
    saliency : (h, w) float32, >= 0
        Of the image's pixels.
    described : DescriptorMap, optional
        Without one, and without `upright`, descriptors have no values.
    upright : UprightPatches, optional
        What describes the keypoints in place of a map, and gives them orientations.
    """

    image: WorkingImage
    saliency: Array
    described: DescriptorMap | None
    upright: UprightPatches | None = None


def detect(seen: Sequence[Seen], params: DetectionParams, watch: Stopwatch) -> Trace:
    """Threshold the saliency, keep its maxima, and read their descriptors off the map.

    Parameters
    ----------
    seen : the image at each working scale, the finest first
    watch : Stopwatch
        Gets the time of each stage.
    """
    levels, points, scores = zip(*(_maxima(one, params, watch) for one in seen), strict=True)
    image = seen[0].image
    if len(seen) == 1:
        with watch("descriptors"):
            places, descriptors, angles = _placed(seen[0], levels[0], points[0], params)
        features = Features(places, scores[0], descriptors, image.scaling.source, params.nms_radius, angles=angles)
        return Trace(features, levels, watch.seconds)
    with watch("nms"):
        level, index = _across_scales(seen, points, scores, params)
        own = [index[level == number] for number in range(len(seen))]
    with watch("descriptors"):
        parts = [_placed(*of, points[i][own[i]], params) for i, of in enumerate(zip(seen, levels, strict=True))]
        order = np.argsort(np.argsort(level, kind="stable"))  # of what is kept, level by level
        places, descriptors, angles = (np.concatenate(part)[order] for part in zip(*parts, strict=True))
    strength = np.concatenate([score[kept] for score, kept in zip(scores, own, strict=True)])[order]
    scales = np.array([one.image.scaling.scale for one in seen])
    sizes = (window_size(params.nms_radius, image.scaling.source) * scales[0] / scales[level]).astype(np.float32)
    features = Features(places, strength, descriptors, image.scaling.source, params.nms_radius, sizes, angles)
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
    seen: Sequence[Seen], points: Sequence[Index], scores: Sequence[Array], params: DetectionParams
) -> tuple[Index, Index]:
    """The keypoints kept, the strongest first: (K,) the level of each, and its index among that level's."""
    candidates = []
    for one, found, strength in zip(seen, points, scores, strict=True):
        scaling = one.image.scaling
        cell, cells = cell_of(found, scaling.working, params.grid)
        candidates.append(Candidates(scaling.to_source(found), strength, scaling.scale, cell, cells))
    radius = min(params.nms_radius, max(seen[0].image.scaling.source))
    return merged(candidates, radius, params.max_keypoints)


def _placed(seen: Seen, level: Level, found: Index, params: DetectionParams) -> tuple[Array, Array, Array]:
    """Where a level's keypoints lie in the source image, (N, 2), their descriptors, (N, D), and angles, (N,)."""
    points = found.astype(np.float32)
    if params.subpixel:
        points = seen.image.kept_inside(quadratic_peaks(level.scores, found), found, params.border)
    angles = np.full(len(points), -1, np.float32)
    if seen.upright is not None:
        angles = seen.upright.angles(points)
        descriptors = seen.upright.at(points, angles)
    elif seen.described is not None:
        descriptors = seen.described.at(points)
    else:
        descriptors = np.zeros((len(points), 0), np.float32)
    return seen.image.scaling.to_source(points), descriptors, angles


def nothing_found(images: Levels, dim: int, params: DetectionParams, watch: Stopwatch) -> Trace:
    """What `detect` would give for an image of one colour, whose saliency is zero; descriptors are of `dim` values."""
    levels = []
    for image in images:
        zero = np.zeros(image.scaling.working, np.float32)
        levels.append(Level(image.scaling.scale, zero, zero, np.zeros(zero.shape, np.bool_), 0.0, zero))
    points, scores, descriptors = (np.zeros(shape, np.float32) for shape in ((0, 2), (0,), (0, dim)))
    features = Features(points, scores, descriptors, images[0].scaling.source, params.nms_radius)
    return Trace(features, tuple(levels), watch.seconds)
