"""What a method is. A plugin is a function ``Spec -> Method``, named as ``plugin:module.function``."""

from __future__ import annotations

import hashlib
from pathlib import Path

from elf_eval.data.images import Image
from elf_eval.errors import EvalError
from elf_eval.features import LocalFeatures


class Method:
    """A detector, a descriptor, or both.

    Attributes
    ----------
    fingerprint : str
        Names all that the features depend on (settings, hashes of files, versions): the cache's key.
    cacheable : bool
        False where looking the features up costs no more than the cache would.
    """

    fingerprint: str
    cacheable: bool = True

    def extract(self, image: Image, limit: int) -> LocalFeatures:
        """At most `limit` keypoints, the strongest, with descriptors where the method has its own.

        Raises
        ------
        EvalError
            If the method only describes.
        """
        del image, limit
        raise EvalError(f"{type(self).__name__} has no detector of its own; choose one with --detector")

    def describe(self, image: Image, features: LocalFeatures) -> LocalFeatures:
        """Someone else's keypoints with this method's descriptors; those that it can't describe are left out.

        Raises
        ------
        EvalError
            If the method only detects.
        """
        del image, features
        raise EvalError(f"{type(self).__name__} has no descriptor of its own; choose one with --descriptor")


class Composed(Method):
    """One method's keypoints with another's descriptors."""

    def __init__(self, detector: Method, descriptor: Method) -> None:
        self.detector, self.descriptor = detector, descriptor
        self.fingerprint = f"{detector.fingerprint} | {descriptor.fingerprint}"
        self.cacheable = detector.cacheable and descriptor.cacheable

    def extract(self, image: Image, limit: int) -> LocalFeatures:
        return self.describe(image, self.detector.extract(image, limit))

    def describe(self, image: Image, features: LocalFeatures) -> LocalFeatures:
        return self.descriptor.describe(image, features)


def code_digest(*files: str | Path) -> str:
    """Hash of source files, for a fingerprint: edited code is not measured by yesterday's features."""
    sha = hashlib.sha256()
    for file in sorted(str(f) for f in files):
        sha.update(Path(file).read_bytes())
    return sha.hexdigest()[:12]
