"""Image gradients instead of a network's: the saliency is |Sobel| or |Laplacian| of the grey image."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

import elf_runtime
from elf_eval.errors import EvalError
from elf_eval.features import FloatArray, LocalFeatures
from elf_eval.images import Image
from elf_eval.settings import detection_changes
from elf_eval.spec import Spec
from elf_runtime import SettingError, preset
from elf_runtime.nms import greedy_nms
from elf_runtime.threshold import scores_and_mask

from .base import Method, code_digest


class Gradient(Method):
    """``sobel`` or ``laplacian``: the paper's baseline, with ELF's own threshold and suppression.

    Options: ``preset=paper`` (the default) and the detection settings, but ``scale``.
    """

    def __init__(self, spec: Spec, threads: int | None) -> None:
        del threads
        self._kind = spec.kind
        name = spec.take("preset", str, "paper")
        try:
            self._params = preset(name, spec.kind).updated(**detection_changes(spec))
        except SettingError as error:
            raise EvalError(f"{spec.text}: {error}") from error
        if self._params.scale != 1.0:
            raise EvalError(f"{spec.text}: an image gradient works at full resolution, not at scale")
        code = code_digest(*Path(elf_runtime.__file__).parent.glob("*.py"), __file__)
        self.fingerprint = json.dumps(
            [spec.kind, self._params.to_dict(), code, cv2.__version__], sort_keys=True
        )

    def extract(self, image: Image, limit: int) -> LocalFeatures:
        grey = cv2.cvtColor(image.pixels, cv2.COLOR_BGR2GRAY).astype(np.float32)
        scores, mask = scores_and_mask(gradient_saliency(grey, self._kind), self._params)
        inner = np.zeros_like(mask)
        edge = slice(self._params.border, -self._params.border or None)
        inner[edge, edge] = mask[edge, edge]
        points, strength = greedy_nms(scores, inner, self._params.nms_radius, limit)
        return LocalFeatures.build(points, strength, sizes=2.0 * self._params.nms_radius + 1.0)


def gradient_saliency(grey: FloatArray, kind: str) -> FloatArray:
    """(H, W) float32, >= 0: the 3x3 Sobel gradient's magnitude, or the absolute 3x3 Laplacian."""
    if kind == "laplacian":
        return np.asarray(np.abs(cv2.Laplacian(grey, cv2.CV_32F, ksize=3)), np.float32)
    dx = cv2.Sobel(grey, cv2.CV_32F, 1, 0, ksize=3)
    dy = cv2.Sobel(grey, cv2.CV_32F, 0, 1, ksize=3)
    return np.asarray(np.hypot(dx, dy), np.float32)
