"""The steps of docs/contract.md, taken with numpy, OpenCV and ONNX Runtime alone, give ElfRuntime's keypoints."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
import onnxruntime as ort
import pytest

from elf_runtime import ElfRuntime, preset
from elf_runtime.model import bundled_model
from helpers import ROOT

PALACE = cv2.imread(str(ROOT / "demo" / "palace.jpg"))


def kapur(histogram: np.ndarray) -> int:
    best, level = -math.inf, -1
    for t in range(255):
        sides = [side[side > 0] / side.sum() for side in (histogram[: t + 1], histogram[t + 1 :]) if side.any()]
        entropy = sum(-(p * np.log(p)).sum() for p in sides)
        if len(sides) == 2 and entropy > best:
            best, level = entropy, t
    return level


def by_the_steps(image: np.ndarray, given: Mapping[str, Any] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Keypoints and descriptors, by the numbered steps."""
    session = ort.InferenceSession(str(bundled_model("int8")), providers=["CPUExecutionProvider"])
    meta = {key: json.loads(value) for key, value in session.get_modelmeta().custom_metadata_map.items()}
    settings, spec, first = given or meta["elf.detection"], meta["elf.input"], meta["elf.descriptors"][0]
    # 1
    height, width = image.shape[:2]
    scale = settings["scale"]
    if scale < 1:
        scale = max(scale, spec["min_size"] / min(width, height))
    w, h = round(width * scale), round(height * scale)
    method = cv2.INTER_AREA if w * h < width * height else cv2.INTER_LINEAR
    pixels = image.astype(np.float32)
    if (w, h) != (width, height):
        pixels = cv2.resize(pixels, (w, h), interpolation=method)
    names = [meta["elf.saliency_output"], first["output"]]
    saliency, maps = (out[0] for out in session.run(names, {spec["name"]: pixels[None]}))
    # 2
    q = np.sort(saliency.ravel())[math.ceil(settings["normalize"] * saliency.size) - 1] or saliency.max()
    m = saliency * np.float32(255 / float(q))
    if settings["quantize"]:
        m = np.minimum(m, 255).astype(np.uint8)
    # 3
    (mu, sigma), (wide, spread) = settings["denoise"], settings["threshold_blur"]
    scores = cv2.GaussianBlur(m, (mu, mu), sigma)
    levels = cv2.GaussianBlur(np.minimum(m, 255), (wide, wide), spread)
    # 4
    assert settings["threshold"] == "kapur"
    passes = (scores >= kapur(np.bincount(levels.astype(int).ravel(), minlength=256)) + 1) & (scores > 0)
    # 5
    border = settings["border"]
    for axis, (large, small) in enumerate(((height, h), (width, w))):
        centre = (np.arange(small) + 0.5) * large / small - 0.5
        outside = (centre < border) | (centre > large - 1 - border) if border else np.zeros(small, bool)
        passes[(outside, slice(None)) if axis == 0 else (slice(None), outside)] = False
    # 6
    ranks = _rounded(scores)
    radius = max(1, round(settings["nms_radius"] * scale)) if settings["nms_radius"] else 0
    if settings.get("suppression", "greedy") == "maxima":
        for y, x in np.argwhere(passes):
            around = ranks[max(0, y - radius) : y + radius + 1, max(0, x - radius) : x + radius + 1]
            passes[y, x] = ranks[y, x] >= around.max()
    found: list[tuple[int, int]] = []
    for index in np.argsort(-ranks.ravel().astype(float), kind="stable"):
        y, x = divmod(int(index), w)
        if passes[y, x] and len(found) < settings["max_keypoints"]:
            found.append((x, y))
            passes[max(0, y - radius) : y + radius + 1, max(0, x - radius) : x + radius + 1] = False
    found.sort(key=lambda place: -float(scores[place[1], place[0]]))
    # 7
    ratio = np.array([w / width, h / height])
    points = np.array(found, float)
    for row, (x, y) in enumerate(found if settings["subpixel"] else []):
        moved = points[row] + _step(scores, x, y)
        source = (moved + 0.5) / ratio - 0.5
        if not border or ((source >= border) & (source <= np.array([width, height]) - 1 - border)).all():
            points[row] = moved
    # 8
    rows = []
    for x, y in points:
        u, v = ((t - first["offset"]) / first["stride"] for t in (x, y))
        u, v = min(max(u, 0), maps.shape[1] - 1), min(max(v, 0), maps.shape[0] - 1)
        i, j = min(int(u), maps.shape[1] - 2), min(int(v), maps.shape[0] - 2)
        fu, fv = u - i, v - j
        cells = maps[j : j + 2, i : i + 2]
        d = (1 - fv) * ((1 - fu) * cells[0, 0] + fu * cells[0, 1]) + fv * ((1 - fu) * cells[1, 0] + fu * cells[1, 1])
        rows.append(d / np.linalg.norm(d))
    # 9
    return (points + 0.5) / ratio - 0.5, np.array(rows)


def _rounded(scores: np.ndarray) -> np.ndarray:
    """Step 6: to 14 significant bits."""
    if scores.dtype == np.uint8:
        return scores
    t = np.float32(1024) * scores + scores
    return t - (t - scores)


def _step(given: np.ndarray, x: int, y: int) -> np.ndarray:
    """Step 7: how far (x, y) moves."""
    (h, w), scores, ranks = given.shape, given.astype(float), _rounded(given).astype(float)
    free = (0 < x < w - 1, 0 < y < h - 1)
    b, step, slope, curve = scores[y, x], np.zeros(2), [0.0, 0.0], [0.0, 0.0]
    e = b / 4096
    for axis, (dx, dy) in enumerate(((1, 0), (0, 1))):
        if free[axis]:
            a, c = scores[y - dy, x - dx], scores[y + dy, x + dx]
            slope[axis], curve[axis] = (c - a) / 2, a - 2 * b + c
            highest = ranks[y, x] >= max(ranks[y - dy, x - dx], ranks[y + dy, x + dx])
            if highest and curve[axis] < -e:
                step[axis] = np.clip(-slope[axis] / curve[axis], -0.5, 0.5)
    if all(free) and ranks[y - 1 : y + 2, x - 1 : x + 2].max() <= ranks[y, x] and max(curve) < 0:
        m = (scores[y + 1, x + 1] + scores[y - 1, x - 1] - scores[y - 1, x + 1] - scores[y + 1, x - 1]) / 4
        d = curve[0] * curve[1] - m * m
        if d > -e * sum(curve):
            tops = (m * slope[1] - curve[1] * slope[0]) / d, (m * slope[0] - curve[0] * slope[1]) / d
            step = np.clip(tops, -0.5, 0.5)
    return step


def test_the_example_is_of_the_bundled_model() -> None:
    text = (ROOT / "docs" / "contract.md").read_text(encoding="utf-8")
    row = next(line for line in text.splitlines() if line.startswith("| `elf.descriptors`"))
    example = json.loads(row.rsplit("`", 2)[1])
    spec = ElfRuntime().contract.descriptors[0]
    assert example == [{key: getattr(spec, key) for key in ("output", "layer", "dim", "stride", "offset")}]


@pytest.mark.parametrize("name", [None, "fast", "accurate", "paper"])
def test_the_steps_give_the_keypoints(name: str | None) -> None:
    image = PALACE if name is None else PALACE[100:340, 200:520]
    wanted = ElfRuntime(threads=1).detect(image, preset=name)
    points, rows = by_the_steps(image, preset(name).to_dict() if name else None)
    assert len(wanted) > 40
    np.testing.assert_allclose(points, wanted.keypoints, atol=0.02)
    np.testing.assert_allclose(rows, wanted.descriptors, atol=1e-3)


def test_a_small_image_is_seen_at_a_larger_scale() -> None:
    image = PALACE[120:170, 200:260]
    wanted = ElfRuntime(threads=1).detect(image, border=0)
    settings = {**preset("default").to_dict(), "border": 0}
    points, _ = by_the_steps(image, settings)
    assert len(wanted) > 5
    np.testing.assert_allclose(points, wanted.keypoints, atol=0.02)
