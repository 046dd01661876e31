"""From one image's maps to its keypoints, scores and descriptors: the steps of the runtime's `detection`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elf_export.graph.graph import Graph
from elf_runtime import DetectionParams, ModelContract

from .describe import described
from .emit import DOUBLE, FLOAT, Emit, f32, f64, i64
from .levels import rounded, scores_and_level
from .places import (
    allowed_pixels,
    contrast_window,
    enough_contrast,
    looked_up,
    mask_border,
    shrunk,
    textured,
    within_border,
)
from .refine import quadratic_peaks, split
from .resize import Working
from .suppress import Window, greedy, strongest, window_maxima

MASK, MOST, THRESHOLD = "mask", "max_keypoints", "threshold"
"""The inputs that have defaults."""


@dataclass(frozen=True)
class Maps:
    """What the network gives for one image: saliency (1, h, w), and, if it describes, descriptors (1, h', w', D)."""

    saliency: str
    descriptors: str | None


@dataclass(frozen=True)
class Found:
    """Names of what there is of one image: keypoints (K, 2), scores (K,) and, if it describes, descriptors (K, D).

    The first `count`, int64 (), of the rows are keypoints: all, or none of one row.
    """

    rows: tuple[str, ...]
    count: str


def keypoints_of(graph: Graph, working: Working, maps: Maps, contract: ModelContract, rounds: int) -> Found:
    """The keypoints of one image, `working` being its.

    `rounds` are those of the suppression; see `build.Form`.
    """
    params = contract.detection
    e = Emit(graph, "places")
    inside = shrunk(e, MASK, mask_border(e, params, contract.receptive_field, working.scale))
    allowed = allowed_pixels(e, inside, working)
    scores, level = scores_and_level(Emit(graph, "levels"), maps.saliency, params, allowed, THRESHOLD)
    passed = _passed(graph, working, contract, scores, level, allowed)
    e = Emit(graph, "suppress")
    ranks = rounded(e, scores)
    window = Window.of(e, params.nms_radius, params.scale, working.scale, one_for_all=rounds > 0)
    if params.suppression == "maxima":
        passed = e("And", passed, window_maxima(e, ranks, window))
    strength, flat, count = strongest(e, scores, ranks, greedy(e, ranks, passed, window, rounds), MOST)
    x, y = _placed(graph, working, params, scores, flat, inside)
    e = Emit(graph, "source")
    columns = [e.column(e.cast(working.to_source(e, at, axis), FLOAT)) for at, axis in ((x, 1), (y, 0))]
    keypoints, spec = e("Concat", *columns, axis=1), contract.descriptor()
    if spec is None or maps.descriptors is None:
        return Found((keypoints, strength), count)
    return Found((keypoints, strength, described(Emit(graph, "describe"), maps.descriptors, spec, x, y)), count)


def _passed(graph: Graph, working: Working, contract: ModelContract, scores: str, level: str, allowed: str) -> str:
    """(1, 1, h, w) bool: the pixels that may be keypoints, before any suppresses another."""
    params, e = contract.detection, Emit(graph, "passed")
    conditions = [allowed, within_border(e, params.border, working), textured(e, working.pixels)]
    if params.min_contrast > 0:
        side = contrast_window(contract.receptive_field)
        least = params.min_contrast * contract.input.value_range / 255
        conditions.append(enough_contrast(e, working.pixels, contract.input.channels, side, least))
    places = e("Unsqueeze", e.both(*conditions), np.array([0, 1], i64))
    return e.both(places, e("Not", e("Less", scores, level)), e("Greater", scores, f32(0)))


def _placed(
    graph: Graph, working: Working, params: DetectionParams, scores: str, flat: str, inside: str
) -> tuple[str, str]:
    """x and y in working pixels, (K,) float64: refined, but where that would leave what border and mask allow."""
    e = Emit(graph, "refine")
    x, y = split(e, flat, working.working[1])
    whole = (e.cast(x, DOUBLE), e.cast(y, DOUBLE))
    if not params.subpixel:
        return whole
    # The runtime's places are float32 in between.
    tops = quadratic_peaks(e, scores, x, y, working.working)
    refined = (e.cast(e.cast(tops[0], FLOAT), DOUBLE), e.cast(e.cast(tops[1], FLOAT), DOUBLE))
    stays = [looked_up(e, inside, *refined, working)]
    if params.border:
        for at, axis in ((refined[0], 1), (refined[1], 0)):
            place = working.to_source(e, at, axis)
            most = e.cast(e("Sub", working.source[axis], i64(1 + params.border)), DOUBLE)
            stays += [e("Not", e("Less", place, f64(params.border))), e("Not", e("Greater", place, most))]
    kept = e.both(*stays)
    return e("Where", kept, refined[0], whole[0]), e("Where", kept, refined[1], whole[1])
