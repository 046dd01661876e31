"""ELF's detection: from the saliency map of an image to its features."""

from __future__ import annotations

import numpy as np

from elf_runtime.params import DetectionParams
from elf_runtime.results.features import Features
from elf_runtime.results.trace import Stopwatch, Trace

from .descriptors import Array, DescriptorMap
from .grid import passing_by_cell
from .refine import parabola_peaks
from .select import select_keypoints
from .threshold import blurred, passing
from .working_image import WorkingImage


def detect(
    image: WorkingImage, saliency: Array, described: DescriptorMap | None, params: DetectionParams, watch: Stopwatch
) -> Trace:
    """Threshold the saliency, keep its maxima, and read their descriptors off the map.

    Parameters
    ----------
    image : WorkingImage
    saliency : (h, w) float32, >= 0
        Of the image's pixels.
    described : DescriptorMap, optional
        Without one, descriptors have no values.
    watch : Stopwatch
        Gets the time of each stage.
    """
    with watch("blur"):
        allowed = image.allowed()
        scores, smooth = blurred(saliency, params, allowed)
    with watch("threshold"):
        if params.grid == (1, 1):
            mask = passing(scores, smooth, params, allowed)
        else:
            mask = passing_by_cell(saliency, params, allowed)
    with watch("nms"):
        found, strength = select_keypoints(scores, mask, image, params)
        # The paper's scores were of 8 bits so far.
        values, best = scores.astype(np.float32, copy=False), strength.astype(np.float32, copy=False)
    with watch("descriptors"):
        points = found.astype(np.float32)
        if params.subpixel:
            points = image.kept_inside(parabola_peaks(values, found), found, params.border)
        descriptors = described.at(points) if described is not None else np.zeros((len(points), 0), np.float32)
    places = image.scaling.to_source(points)
    features = Features(places, best, descriptors, image.scaling.source, params.nms_radius)
    return Trace(features, saliency, values, mask, watch.seconds)


def nothing_found(image: WorkingImage, dim: int, params: DetectionParams, watch: Stopwatch) -> Trace:
    """What `detect` would give for an image of one colour, whose saliency is zero; descriptors are of `dim` values."""
    zero = np.zeros(image.scaling.working, np.float32)
    points, scores, descriptors = (np.zeros(shape, np.float32) for shape in ((0, 2), (0,), (0, dim)))
    features = Features(points, scores, descriptors, image.scaling.source, params.nms_radius)
    return Trace(features, zero, zero, np.zeros(zero.shape, np.bool_), watch.seconds)
