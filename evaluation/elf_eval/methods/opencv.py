"""OpenCV's detectors and descriptors, as far as the installed build has them."""

from __future__ import annotations

import ast
from typing import Any

import cv2
import numpy as np

from elf_eval.data.images import Image
from elf_eval.errors import EvalError
from elf_eval.features import LocalFeatures
from elf_eval.fingerprint import code_digest, file_digest
from elf_eval.spec import Spec

from .method import Method

# Name in OpenCV, and the argument that sets the number of keypoints.  A method without one finds what its thresholds
# let through, and the strongest of that are kept.
OPENCV: dict[str, tuple[str, str]] = {
    "sift": ("SIFT", "nfeatures"),
    "orb": ("ORB", "nfeatures"),
    "kaze": ("KAZE", ""),
    "akaze": ("AKAZE", ""),
    "brisk": ("BRISK", ""),
    "surf": ("SURF", ""),
    "mser": ("MSER", ""),
    "fast": ("FastFeatureDetector", ""),
    "gftt": ("GFTTDetector", "maxCorners"),
    "cv2-aliked": ("ALIKED", ""),
    "cv2-disk": ("DISK", "maxKeypoints"),
}
_NETWORKS = ("cv2-aliked", "cv2-disk")
_DETECTORS = ("mser", "fast", "gftt")


class OpenCv(Method):
    """``sift``, ``orb``, ``mser``, ``cv2-aliked:MODEL.onnx`` ...; options are OpenCV's own arguments.

    Grey images for all but the networks.  Numbers are converted (``contrastThreshold=0.01``), and so are sizes: a
    network resizes the image to ALIKED's ``inputSize=640,640`` or DISK's ``imageSize=1024,1024``.
    """

    def __init__(self, spec: Spec, threads: int | None) -> None:
        if threads is not None:
            cv2.setNumThreads(threads)
        self._kind = spec.kind
        name, self._count = OPENCV[spec.kind]
        self._factory = _factory(name, spec.kind)
        self._arguments: dict[str, Any] = {k: spec.take(k, _number, None) for k in list(spec.options)}
        self._positional: list[str] = []
        model = ""
        if spec.kind in _NETWORKS:
            path = spec.file(f"OpenCV's {name} takes its network as an .onnx file")
            self._positional, model = [str(path)], file_digest(path)
        self._made: dict[int, Any] = {}
        self._make(500)
        settings = sorted(self._arguments.items())
        code = code_digest("elf_eval.methods.opencv", "elf_eval.features")
        self.fingerprint = f"opencv {cv2.__version__} {spec.kind} {settings} {model} {code}"

    def _make(self, limit: int) -> Any:
        if limit not in self._made:
            arguments = dict(self._arguments)
            if self._count:
                arguments.setdefault(self._count, limit)
            try:
                if self._kind == "cv2-aliked":
                    arguments = {"params": _aliked_params(arguments)}
                self._made[limit] = self._factory(*self._positional, **arguments)
            except (cv2.error, TypeError) as error:
                reason = str(error).strip().splitlines()[-1]
                raise EvalError(f"{self._kind}: OpenCV does not take {arguments}: {reason}") from error
        return self._made[limit]

    def _input(self, image: Image) -> Any:
        return image.pixels if self._kind in _NETWORKS else cv2.cvtColor(image.pixels, cv2.COLOR_BGR2GRAY)

    def extract(self, image: Image, limit: int) -> LocalFeatures:
        engine, pixels = self._make(limit), self._input(image)
        if self._kind in _DETECTORS:
            keypoints, descriptors = engine.detect(pixels, None), None
        else:
            keypoints, descriptors = engine.detectAndCompute(pixels, None)
            descriptors = _no_descriptors(engine) if descriptors is None else descriptors
        if not keypoints:
            return LocalFeatures.build(np.zeros((0, 2)), 0.0, descriptors)
        # MSER has no response: its largest regions first.
        score = [k.size if self._kind == "mser" else k.response for k in keypoints]
        return LocalFeatures.build(
            [k.pt for k in keypoints],
            score,
            descriptors,
            [k.size for k in keypoints],
            [k.angle for k in keypoints],
        ).first(limit)

    def describe(self, image: Image, features: LocalFeatures) -> LocalFeatures:
        if self._kind in _DETECTORS + _NETWORKS:
            raise EvalError(f"{self._kind} can't describe keypoints of another detector")
        keypoints = [
            # class_id leads back to the row, because OpenCV drops keypoints that are too close to the border.
            cv2.KeyPoint(float(x), float(y), float(size), max(float(angle), 0.0), float(score), 0, i)
            for i, ((x, y), size, angle, score) in enumerate(
                zip(features.keypoints, features.sizes, features.angles, features.scores, strict=True)
            )
        ]
        engine = self._make(max(1, len(keypoints)))
        kept, descriptors = engine.compute(self._input(image), keypoints)
        if not kept:
            return features.take(slice(0)).described(_no_descriptors(engine))
        return features.take([k.class_id for k in kept]).described(np.asarray(descriptors))


def installed(kind: str) -> bool:
    """Whether the installed OpenCV has this method; most builds have SURF by name only."""
    factory = _find(OPENCV[kind][0])
    if factory is None or kind in _NETWORKS:
        return factory is not None
    try:
        factory()
    except cv2.error:
        return False
    return True


def _find(name: str) -> Any:
    modules = (cv2, getattr(cv2, "xfeatures2d", None))
    return next((f for f in (getattr(m, f"{name}_create", None) for m in modules) if f is not None), None)


def _factory(name: str, kind: str) -> Any:
    if not installed(kind):
        where = "OpenCV 5 has it" if kind in _NETWORKS else "opencv-contrib-python-headless may have it"
        raise EvalError(
            f"{kind}: this OpenCV build ({cv2.__version__}) has no {name}; "
            f"{where}, or read the features from disk (npz:, h5:)"
        )
    return _find(name)


def _aliked_params(arguments: dict[str, Any]) -> Any:
    """OpenCV's ALIKED takes an object with its arguments; a TypeError on one that it does not have."""
    params = cv2.ALIKED.Params()
    for name, value in arguments.items():
        if not hasattr(params, name):
            raise TypeError(f"{name} is none of {[n for n in dir(params) if not n.startswith('_')]}")
        setattr(params, name, value)
    return params


def _no_descriptors(engine: Any) -> Any:
    """(0, D) of the engine's D and type."""
    binary = engine.descriptorType() == cv2.CV_8U
    return np.zeros((0, engine.descriptorSize()), np.uint8 if binary else np.float32)


def _number(text: str) -> Any:
    try:
        return ast.literal_eval(text)  # 3, 0.04
    except (ValueError, SyntaxError):
        return {"true": True, "false": False}.get(text, text)
