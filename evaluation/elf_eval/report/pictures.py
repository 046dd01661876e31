"""Pictures of matches: two images side by side, with right matches in green and wrong ones in red."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_eval.data import Pair, is_of, open_dataset
from elf_eval.errors import EvalError
from elf_eval.features import ImageFeatures
from elf_eval.methods import open_methods
from elf_eval.metrics.family import FeaturePair
from elf_eval.protocol import Protocol
from elf_eval.run.cache import FeatureCache
from elf_eval.run.refinement import refined_points
from elf_eval.run.results import Results
from elf_eval.run.runner import Resources
from elf_eval.suite.suite import Suite

from .method_names import wrapped

_GREEN, _RED, _GREY, _BLUE = (60, 180, 60), (60, 60, 230), (160, 160, 160), (220, 150, 40)  # BGR

_FONT = (cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)  # face, scale, thickness


def write_pictures(suite: Suite, results: Results, folder: Path, resources: Resources) -> list[Path]:
    """Write the suite's pictures of the methods that the results have; the features come from the cache."""
    written = []
    cache = FeatureCache(resources.cache)
    specs = {entry.name: entry.spec for entry in suite.datasets}
    measured = {m["name"] for m in results.methods}
    there = {d["name"] for d in results.datasets}
    for entry in (picture for picture in suite.pictures if picture.dataset in there):
        incomplete: dict[str, str] = {}  # the run has named what is missing
        dataset = open_dataset(suite.expand(specs[entry.dataset]), incomplete)
        if is_of(entry.pair, incomplete):
            continue
        pair = dataset.pair(entry.pair)
        for method_entry in suite.methods:
            name = method_entry.name
            if name not in measured or (entry.methods and name not in entry.methods):
                continue
            method = open_methods(*suite.texts(method_entry), resources.threads)
            first, second = (cache.get(method, ref, suite.protocol)[1] for ref in (pair.first, pair.second))
            protocol = method.protocol(suite.protocol)
            picture = draw_matches(*pair.pixels(protocol.size), first, second, pair, protocol, name)
            slug = "".join(c if c.isalnum() else "-" for c in f"{entry.pair}-{name}".lower())
            folder.mkdir(parents=True, exist_ok=True)
            path = folder / f"{slug}.jpg"
            if not cv2.imwrite(str(path), picture, [cv2.IMWRITE_JPEG_QUALITY, 85]):
                raise EvalError(f"{path}: the picture can't be written")
            written.append(path)
    return written


def draw_matches(
    pixels1: npt.NDArray[np.uint8],
    pixels2: npt.NDArray[np.uint8],
    first: ImageFeatures,
    second: ImageFeatures,
    pair: Pair,
    protocol: Protocol,
    title: str,
) -> npt.NDArray[Any]:
    """Two (H, W, 3) BGR images with their matches, after ratio test and refinement if the protocol has them.

    Green ones lie within the protocol's `eps` pixels of the truth, red ones don't, and of grey ones it is not known.
    Keypoints without a match are small blue dots; a method without descriptors has nothing else.
    """
    offset = pixels1.shape[1] + 4
    height = max(pixels1.shape[0], pixels2.shape[0])
    canvas = np.full((height, offset + pixels2.shape[1], 3), 255, np.uint8)
    canvas[: pixels1.shape[0], : pixels1.shape[1]] = pixels1
    canvas[: pixels2.shape[0], offset:] = pixels2
    a, b = first.features, second.features
    for shift, points in ((0, a.keypoints), (offset, b.keypoints)):
        for x, y in points:
            cv2.circle(canvas, _at(x + shift, y), 2, _BLUE, -1, cv2.LINE_AA)
    truth = pair.truth.at(first.to_working, second.to_working)
    refined = partial(refined_points, first, second, (pixels1, pixels2))
    measured = FeaturePair(first, second, truth, protocol, refined)
    p1, p2 = measured.matched_points if measured.is_described else (np.zeros((0, 2)), np.zeros((0, 2)))
    forward = truth.forward
    error = np.full(len(p1), np.nan) if forward is None else np.linalg.norm(forward(p1) - p2, axis=1)
    right = error <= protocol.eps
    for i in np.argsort(right, kind="stable"):  # draws the right ones on top
        colour = _GREY if np.isnan(error[i]) else _GREEN if right[i] else _RED
        ends = _at(*p1[i]), _at(p2[i, 0] + offset, p2[i, 1])
        cv2.line(canvas, *ends, colour, 1, cv2.LINE_AA)
        for end in ends:
            cv2.circle(canvas, end, 3, colour, 1, cv2.LINE_AA)
    text = f"{title}: {len(a)} and {len(b)} keypoints, {len(p1)} matches"
    text += f", {int(right.sum())} within {protocol.eps:g} px" if len(p1) else ""
    return np.concatenate([_title(text, canvas.shape[1]), canvas])


def _title(text: str, width: int) -> npt.NDArray[np.uint8]:
    """(height, width, 3) white, with the text in as many lines as it needs; OpenCV's fonts have ASCII only."""
    plain = text.encode("ascii", "replace").decode()
    for length in range(len(plain), 0, -1):
        lines = wrapped(plain, length, len(plain)).split("\n")
        if all(cv2.getTextSize(line, *_FONT)[0][0] <= width - 16 for line in lines):
            break
    band = np.full((18 * len(lines) + 8, width, 3), 255, np.uint8)
    for i, line in enumerate(lines):
        cv2.putText(band, line, (8, 18 * (i + 1)), _FONT[0], _FONT[1], (0, 0, 0), _FONT[2], cv2.LINE_AA)
    return band


def _at(x: float, y: float) -> tuple[int, int]:
    return round(float(x)), round(float(y))
