"""The paper's two metrics, which the runtime defines, since the exporter's checks use them too."""

from __future__ import annotations

import numpy as np

from elf_runtime.checks.repeatability import covisible, repeatability_and_matching_score

from .family import FeaturePair, MetricFamily, Record


def _measure(pair: FeaturePair) -> Record:
    assert pair.truth.forward is not None
    assert pair.truth.backward is not None
    p1, p2 = pair.first.features.keypoints, pair.second.features.keypoints
    seen = covisible(p1, p2, pair.truth.forward, pair.truth.backward, pair.first.size, pair.second.size)
    distance = pair.descriptor_distance[np.ix_(seen.first, seen.second)] if pair.is_described else None
    rep, ms, _ = repeatability_and_matching_score(seen, distance, pair.protocol.eps)
    record: Record = {"seen1": len(seen.first), "seen2": len(seen.second), "rep": rep}
    return record if ms is None else record | {"ms": ms}


REPEATABILITY = MetricFamily(_measure, counts=("seen1", "seen2"), shares=("rep", "ms"), truth="place")
