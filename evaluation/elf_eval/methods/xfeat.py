"""XFeat from its public ONNX file: an example of a method that brings its own decoding.

Potje et al., "XFeat: Accelerated Features for Lightweight Image Matching", CVPR 2024, section 3.2.  The graph
gives, for an image of (H, W), maps of (H / 8, W / 8):

    keypoint_logits  65 channels: softmax over the 64 pixels of a cell and "no keypoint here"
    reliability      probability that the descriptor of the cell can be matched
    descriptors      64 channels, not yet of unit length

The score of a pixel is its keypoint probability times the reliability there.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import onnxruntime as ort

from elf_eval.coordinates import Float
from elf_eval.data.images import Image
from elf_eval.errors import EvalError
from elf_eval.features import FloatArray, LocalFeatures
from elf_eval.fingerprint import code_digest, file_digest
from elf_eval.spec import Spec

from .method import Method

CELL = 8  # pixels
_MULTIPLE = 32  # the encoder halves the image five times


class XFeat(Method):
    """``xfeat:FILE.onnx``; options ``threshold=0.05`` (of a keypoint) and ``nms_radius=2`` (pixels)."""

    def __init__(self, spec: Spec, threads: int | None) -> None:
        path = spec.file("XFeat's ONNX file")
        self._threshold = spec.take("threshold", float, 0.05)
        self._radius = spec.take("nms_radius", int, 2)
        options = ort.SessionOptions()
        if threads is not None:
            options.intra_op_num_threads = threads
        options.log_severity_level = 3
        # Threads that spin after a run would take the cores of whatever is timed next.
        options.add_session_config_entry("session.force_spinning_stop", "1")
        try:
            self._session = ort.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's own exceptions share no base of theirs
            raise EvalError(f"{path}: onnxruntime can't load it: {error}") from error
        names = {output.name for output in self._session.get_outputs()}
        if missing := {"descriptors", "keypoint_logits", "reliability"} - names:
            raise EvalError(f"{path}: not XFeat's graph: outputs {sorted(missing)} are missing")
        self._input = self._session.get_inputs()[0].name
        settings = [self._threshold, self._radius]
        code = code_digest("elf_eval.methods.xfeat", "elf_eval.features")
        self.fingerprint = f"xfeat {file_digest(path)} {settings} {ort.__version__} {code}"

    def extract(self, image: Image, limit: int) -> LocalFeatures:
        descriptors, logits, reliability, ratio = self._run(image)
        heat = keypoint_probability(logits)
        candidates = np.argwhere(local_maxima(heat, self._radius) & (heat > self._threshold))
        points = candidates[:, ::-1].astype(np.float32)
        trust = sample_cells(reliability[None], points)[:, 0]
        scores = heat[candidates[:, 0], candidates[:, 1]] * trust
        found = LocalFeatures.build(points, scores).first(limit)
        own = sample_descriptors(descriptors, found.keypoints)
        return LocalFeatures.build((found.keypoints + 0.5) / ratio - 0.5, found.scores, own)

    def describe(self, image: Image, features: LocalFeatures) -> LocalFeatures:
        descriptors, _, _, ratio = self._run(image)
        points = ((features.keypoints + 0.5) * ratio - 0.5).astype(np.float32)
        return features.described(sample_descriptors(descriptors, points))

    def _run(self, image: Image) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Descriptors (64, h, w), logits (65, h, w), reliability (h, w), and network pixels per pixel."""
        width, height = image.size
        size = tuple(max(_MULTIPLE, n // _MULTIPLE * _MULTIPLE) for n in (width, height))
        pixels = image.pixels if size == (width, height) else cv2.resize(image.pixels, size)
        rgb = pixels[:, :, ::-1].transpose(2, 0, 1)[None].astype(np.float32) / np.float32(255.0)
        names = ["descriptors", "keypoint_logits", "reliability"]
        descriptors, logits, reliability = self._session.run(names, {self._input: rgb})
        ratio = np.array([size[0] / width, size[1] / height], np.float32)
        return descriptors[0], logits[0], reliability[0, 0], ratio


def keypoint_probability(logits: FloatArray) -> FloatArray:
    """(65, h, w) logits -> (8 h, 8 w) probabilities: channel 8 r + c is row r, column c of the cell."""
    exponent = np.exp(logits - logits.max(axis=0))
    probability = (exponent / exponent.sum(axis=0))[:-1]
    h, w = logits.shape[1:]
    cells = probability.reshape(CELL, CELL, h, w).transpose(2, 0, 3, 1)
    return np.asarray(cells.reshape(h * CELL, w * CELL), np.float32)


def local_maxima(heat: FloatArray, radius: int) -> npt.NDArray[np.bool_]:
    """(H, W) bool: whether a pixel is the highest of its window of 2 radius + 1 pixels."""
    window = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    return np.asarray(heat == cv2.dilate(heat, window))


def sample_cells(maps: FloatArray, points: FloatArray, cubic: bool = False) -> FloatArray:
    """(N, C) values of (C, h, w) maps at (N, 2) pixels; the centre of cell i lies at pixel 8 i + 3.5.

    Bilinear, or bicubic with Keys' kernel (a = -0.75); outside the map its border cells are repeated.
    """
    height, width = maps.shape[1:]
    cells = (points.astype(np.float64) + 0.5) / CELL - 0.5
    floor = np.floor(cells).astype(np.int64)
    reach = range(-1, 3) if cubic else range(2)
    out = np.zeros((len(points), len(maps)))
    for dy in reach:
        row = np.clip(floor[:, 1] + dy, 0, height - 1)
        weight_y = _kernel(cells[:, 1] - (floor[:, 1] + dy), cubic)
        for dx in reach:
            column = np.clip(floor[:, 0] + dx, 0, width - 1)
            weight = weight_y * _kernel(cells[:, 0] - (floor[:, 0] + dx), cubic)
            out += weight[:, None] * maps[:, row, column].T
    return out.astype(np.float32)


def _kernel(distance: Float, cubic: bool) -> Float:
    x, a = np.abs(distance), -0.75
    if not cubic:
        return np.maximum(1.0 - x, 0.0)
    near = ((a + 2.0) * x - (a + 3.0)) * x * x + 1.0
    far = ((a * x - 5.0 * a) * x + 8.0 * a) * x - 4.0 * a
    return np.where(x <= 1.0, near, np.where(x < 2.0, far, 0.0))


def sample_descriptors(maps: FloatArray, points: FloatArray) -> FloatArray:
    """(N, 64) of unit rows: the cells' unit descriptors, interpolated and made unit again."""
    unit = maps / np.maximum(np.linalg.norm(maps, axis=0), 1e-12)
    rows = sample_cells(unit, points, cubic=True)
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12), np.float32)
