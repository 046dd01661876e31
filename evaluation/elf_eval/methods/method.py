"""What a method is: a detector, a descriptor, or both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from elf_eval.data.images import Image, ImageRef
from elf_eval.errors import EvalError
from elf_eval.features import LocalFeatures
from elf_eval.protocol import Protocol


class Method:
    """A detector, a descriptor, or both.

    Attributes
    ----------
    fingerprint : str
        Names all that the features depend on: settings, digests of files and code, versions.  The cache's key.
    cacheable : bool
        False where looking the features up costs no more than the cache would.
    ratio : float in (0, 1), optional
        Of Lowe's test for the method's matches, ``ratio=0.8`` in its text; the protocol's where None.  Features don't
        depend on it, so it is no part of the fingerprint.
    refine : bool, optional
        Whether the method's matches are refined by the images, ``refine=true`` in its text; likewise.
    """

    fingerprint: str
    cacheable: bool = True
    ratio: float | None = None
    refine: bool | None = None

    def protocol(self, shared: Protocol) -> Protocol:
        """The protocol with this method's ratio and refinement where it has its own."""
        ratio = shared.ratio if self.ratio is None else self.ratio
        return replace(shared, ratio=ratio, refine=shared.refine if self.refine is None else self.refine)

    def check(self, refs: Sequence[ImageRef]) -> None:
        """Refuse images that the method has no features of, before a run begins.  Most methods take any.

        Raises
        ------
        EvalError
            Naming the first that is missing, and how many are.
        """
        del refs

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
    """One method's keypoints with another's descriptors, and with its ratio and refinement where it has them."""

    def __init__(self, detector: Method, descriptor: Method) -> None:
        self.detector, self.descriptor = detector, descriptor
        self.fingerprint = f"{detector.fingerprint} | {descriptor.fingerprint}"
        self.cacheable = detector.cacheable and descriptor.cacheable
        self.ratio = detector.ratio if descriptor.ratio is None else descriptor.ratio
        self.refine = detector.refine if descriptor.refine is None else descriptor.refine

    def check(self, refs: Sequence[ImageRef]) -> None:
        self.detector.check(refs)
        self.descriptor.check(refs)

    def extract(self, image: Image, limit: int) -> LocalFeatures:
        return self.describe(image, self.detector.extract(image, limit))

    def describe(self, image: Image, features: LocalFeatures) -> LocalFeatures:
        return self.descriptor.describe(image, features)
