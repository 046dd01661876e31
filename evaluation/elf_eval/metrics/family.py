"""What a metric is: a function of a pair's features and of what is known between its images."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from elf_eval.coordinates import Float
from elf_eval.data.truth import WorkingTruth
from elf_eval.features import ImageFeatures
from elf_eval.protocol import Protocol
from elf_runtime.checks.greedy import Pairs

from .matching import descriptor_distances, mutual_nearest

Record = dict[str, float | None]
Refinement = Callable[[Pairs], Float]  # of (K, 2) matches, the second image's points in pixels, (K, 2)


@dataclass(frozen=True)
class FeaturePair:
    """The features of two images, with their ground truth at the working size.

    What several metrics need is computed once, when the first of them asks.

    Attributes
    ----------
    refined : function, optional
        Needed where the protocol refines matches.
    """

    first: ImageFeatures
    second: ImageFeatures
    truth: WorkingTruth
    protocol: Protocol
    refined: Refinement | None = None

    @cached_property
    def is_described(self) -> bool:
        """Whether there are descriptors; a method that found nothing still has some, of shape (0, D)."""
        return all(image.features.descriptors.shape[1] for image in (self.first, self.second))

    @cached_property
    def descriptor_distance(self) -> Float:
        """(N1, N2) distances between the descriptors of all keypoints."""
        return descriptor_distances(self.first.features.descriptors, self.second.features.descriptors)

    @cached_property
    def matches(self) -> Pairs:
        """(K, 2): mutual nearest neighbours of all keypoints, which pass the protocol's ratio test if it has one."""
        return mutual_nearest(self.descriptor_distance, self.protocol.ratio)

    @cached_property
    def matched_points(self) -> tuple[Float, Float]:
        """(K, 2) each: the matches' pixels in the two images; the second ones refined if the protocol says so."""
        sides, matches = (self.first, self.second), self.matches.T
        first, second = (
            side.features.keypoints[index].astype(np.float64) for side, index in zip(sides, matches, strict=True)
        )
        if self.protocol.refine:
            assert self.refined is not None
            second = self.refined(self.matches)
        return first, second


@dataclass(frozen=True)
class MetricFamily:
    """Metrics that are measured together.

    Attributes
    ----------
    measure : function
        The metrics of a pair, by name.  One that the pair does not have is left out.
    counts, shares : names
        The metrics; of a share, in [0, 1], more is better.
    error : str, optional
        A further one, None where nothing was found.  It is never averaged: its mean would reward failure.  Reports
        take areas under its recall curve, or its median over pairs (`run.averages.median_error`).
    truth : str, optional
        What must be known between the images, as in `Truth.known`.
    descriptors : bool
        Whether the features must have some.
    """

    measure: Callable[[FeaturePair], Record]
    counts: tuple[str, ...] = ()
    shares: tuple[str, ...] = ()
    error: str | None = None
    truth: str | None = None
    descriptors: bool = False

    def is_defined(self, known: Collection[str], is_described: bool) -> bool:
        """Whether it can be measured where this is known and the features are described."""
        return (self.truth is None or self.truth in known) and (is_described or not self.descriptors)


def finite(error: float) -> float | None:
    """None where there is no estimate, as JSON has no infinity."""
    return error if np.isfinite(error) else None
