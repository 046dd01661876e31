"""Any ELF model, through its public runtime."""

from __future__ import annotations

import json

import cv2
import onnxruntime

from elf_eval.data.images import Image
from elf_eval.errors import EvalError
from elf_eval.features import LocalFeatures
from elf_eval.fingerprint import code_digest
from elf_eval.spec import Spec
from elf_runtime import ElfError, ElfRuntime, SettingError, Trace
from elf_runtime.model.bundled import BUNDLED, bundled_model

from .method import Method
from .shared_maps import shared_runtime

# What leads from pixels to features, for the fingerprint; commands, pictures and checks don't.
CODE = (
    *("elf_eval.methods.elf", "elf_eval.features", "elf_runtime.contract", "elf_runtime.params", "elf_runtime.presets"),
    *("elf_runtime.values", "elf_runtime.image", "elf_runtime.model", "elf_runtime.engine", "elf_runtime.detection"),
    *("elf_runtime.entropy", "elf_runtime.results.features", "elf_runtime.results.trace"),
)


class Elf(Method):
    """``elf:FILE.onnx``, or ``elf`` for the bundled model.

    Options: ``precision=fp32`` or ``int8`` (which of the bundled model's files), ``preset=paper``,
    ``descriptor=LAYER``, and every field of `elf_runtime.DetectionParams` (``scale=0.5``, ``denoise=5,2``,
    ``threshold=kapur``, ``nms_radius=10`` ...); ``max_keypoints`` may be fewer than the protocol's, not more.
    """

    def __init__(self, spec: Spec, threads: int | None) -> None:
        path = spec.file("ELF model") if spec.argument else bundled_model(spec.take("precision", _precision, "int8"))
        self._preset = spec.take("preset", str, None) or None
        self._descriptor = spec.take("descriptor", str, None) or None
        self._settings = spec.settings()
        try:
            self._runtime = shared_runtime(path, threads) if spec.shared else ElfRuntime(path, threads=threads)
            params = self._runtime.params(self._preset, **self._settings)
            self._runtime.contract.descriptor(self._descriptor)
        except (ElfError, SettingError) as error:
            raise EvalError(f"{spec.text}: {error}") from error
        self._params = params
        parts = ["elf", self._runtime.sha256, self._descriptor, params.to_dict()]
        # The cache holds times too, and those of shared maps are of the first method alone.
        parts += [code_digest(*CODE), onnxruntime.__version__, *(["shared"] if spec.shared else [])]
        self.fingerprint = json.dumps(parts, sort_keys=True)

    @property
    def title(self) -> str:
        """The network and its layer."""
        contract = self._runtime.contract
        return f"{contract.network} {contract.layer}"

    def trace(self, image: Image, limit: int) -> Trace:
        """The keypoints with the saliency and the threshold that led to them."""
        changes = {**self._settings, "max_keypoints": min(limit, self._settings.get("max_keypoints", limit))}
        return self._runtime.trace(image.pixels, preset=self._preset, descriptor=self._descriptor, **changes)

    def extract(self, image: Image, limit: int) -> LocalFeatures:
        found = self.trace(image, limit).features
        return LocalFeatures.build(found.keypoints, found.scores, found.descriptors, found.sizes, found.angles)

    def describe(self, image: Image, features: LocalFeatures) -> LocalFeatures:
        # With their sizes, by which they find their scale where there are several, and the angles to turn them by.
        columns = (features.keypoints.tolist(), features.sizes.tolist(), features.angles.tolist())
        points = [cv2.KeyPoint(x, y, size, angle) for (x, y), size, angle in zip(*columns, strict=True)]
        return features.described(
            self._runtime.describe(image.pixels, points, descriptor=self._descriptor, params=self._params)
        )


def _precision(text: str) -> str:
    if text not in BUNDLED:
        raise ValueError(f"the bundled model is there in {', '.join(BUNDLED)}")
    return text
