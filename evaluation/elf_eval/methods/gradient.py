"""Image gradients instead of a network's: the saliency is |Sobel| or |Laplacian| of the grey image."""

from __future__ import annotations

import json
from collections.abc import Mapping
from types import MappingProxyType

import cv2
import numpy as np
import numpy.typing as npt

from elf_eval.data.images import Image
from elf_eval.errors import EvalError
from elf_eval.features import FloatArray, LocalFeatures
from elf_eval.fingerprint import code_digest
from elf_eval.spec import Spec
from elf_runtime import SettingError, preset
from elf_runtime.detection.nms import greedy_nms
from elf_runtime.detection.threshold import scores_and_mask

from .method import Method

CODE = (
    *("elf_eval.methods.gradient", "elf_eval.features", "elf_runtime.params", "elf_runtime.presets"),
    *("elf_runtime.values", "elf_runtime.entropy"),
    *("elf_runtime.detection.nms", "elf_runtime.detection.threshold"),
)

# The paper gives no sizes.  A 3x3 Laplacian answers to single pixels, which the paper's blur of 9x9 washes out: few
# keypoints are left, and fewer repeat than Sobel's.  13x13 was chosen on half of the Oxford sequences: the smallest
# that is ahead of Sobel in the matching score, as in the paper, and leaves no image with fewer than 20 keypoints there.
# evaluation/README.md has the figures.
KERNELS: Mapping[str, int] = MappingProxyType({"sobel": 3, "laplacian": 13})
# The settings that mean something without a model, and without the image beside its saliency.
SETTINGS = (
    "denoise",
    "threshold_blur",
    "threshold",
    "nms_radius",
    "border",
    "scale",
    "quantize",
    "subpixel",
    "normalize",
)


class Gradient(Method):
    """``sobel`` or ``laplacian``: the paper's baseline, with ELF's own threshold and suppression.

    Options: ``kernel=K`` (`gradient_saliency`), ``preset=paper`` (the default) and the detection settings of
    `SETTINGS`; ``scale`` is 1.
    """

    def __init__(self, spec: Spec, threads: int | None) -> None:
        del threads
        self._kind = spec.kind
        self._kernel = spec.take("kernel", _kernel, KERNELS[spec.kind])
        name = spec.take("preset", str, "paper")
        try:
            self._params = preset(name, spec.kind).updated(**spec.settings(SETTINGS))
        except SettingError as error:
            raise EvalError(f"{spec.text}: {error}") from error
        if self._params.working_scales != (1.0,):
            raise EvalError(f"{spec.text}: an image gradient works at full resolution, not at scale")
        self.fingerprint = json.dumps(
            [spec.kind, self._kernel, self._params.to_dict(), code_digest(*CODE), cv2.__version__], sort_keys=True
        )

    @property
    def title(self) -> str:
        """The filter and its size."""
        return f"{self._kind} {self._kernel}x{self._kernel}"

    def extract(self, image: Image, limit: int) -> LocalFeatures:
        return self.trace(image, limit)[2]

    def trace(self, image: Image, limit: int) -> tuple[FloatArray, npt.NDArray[np.bool_], LocalFeatures]:
        """The saliency (H, W), what of it passes the threshold, and the keypoints."""
        grey = cv2.cvtColor(image.pixels, cv2.COLOR_BGR2GRAY).astype(np.float32)
        saliency = gradient_saliency(grey, self._kind, self._kernel)
        scores, mask = scores_and_mask(saliency, self._params)
        inner = np.zeros_like(mask)
        edge = slice(self._params.border, -self._params.border or None)
        inner[edge, edge] = mask[edge, edge]
        points, strength = greedy_nms(scores, inner, self._params.nms_radius, limit)
        return saliency, mask, LocalFeatures.build(points, strength, sizes=2.0 * self._params.nms_radius + 1.0)


def gradient_saliency(grey: FloatArray, kind: str, kernel: int | None = None) -> FloatArray:
    """sqrt(gx^2 + gy^2) for ``sobel``, |gxx + gyy| for ``laplacian``, by OpenCV's derivative kernels.

    A kernel of size K smooths by binomials of about that size.  So the Laplacian is that of an image blurred by a
    Gaussian of sigma = sqrt(K - 2) / 2: 1.7 pixels at the default of 13.

    Parameters
    ----------
    grey : (H, W) float32
    kernel : int, optional
        K x K, odd, 1 to 31; `KERNELS` by default.

    Returns
    -------
    (H, W) float32, >= 0
    """
    size = KERNELS[kind] if kernel is None else kernel
    if kind == "laplacian":
        return np.asarray(np.abs(cv2.Laplacian(grey, cv2.CV_32F, ksize=size)), np.float32)
    dx = cv2.Sobel(grey, cv2.CV_32F, 1, 0, ksize=size)
    dy = cv2.Sobel(grey, cv2.CV_32F, 0, 1, ksize=size)
    return np.asarray(np.hypot(dx, dy), np.float32)


def _kernel(text: str) -> int:
    size = int(text)
    if not 1 <= size <= 31 or size % 2 == 0:
        raise ValueError("an odd number from 1 to 31")
    return size
