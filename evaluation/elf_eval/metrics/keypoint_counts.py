"""How many keypoints each image has."""

from __future__ import annotations

from .family import FeaturePair, MetricFamily, Record


def _measure(pair: FeaturePair) -> Record:
    return {"n1": len(pair.first.features), "n2": len(pair.second.features)}


KEYPOINT_COUNTS = MetricFamily(_measure, counts=("n1", "n2"))
