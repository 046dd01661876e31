"""What a method is: a detector, a descriptor, or both."""

from __future__ import annotations

from elf_eval.data.images import Image
from elf_eval.errors import EvalError
from elf_eval.features import LocalFeatures


class Method:
    """A detector, a descriptor, or both.

    Attributes
    ----------
    fingerprint : str
        Names all that the features depend on: settings, digests of files and code, versions.  The cache's key.
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
        """Another method's keypoints with this one's descriptors; those that it can't describe are left out.

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
