"""Results of several kinds of ground truth."""

from __future__ import annotations

import pytest
from made_results import PLACED, POSED, pair


@pytest.fixture
def some_with_depth():
    """One scene of two pairs has depth, with 40 keypoints an image; two scenes of three pairs have none, with 400."""
    with_depth = [pair("depth", n, {**PLACED, **POSED}, 40) for n in (1, 2)]
    return [*with_depth, *(pair(scene, n, POSED, 400) for scene in ("a", "b") for n in (1, 2, 3))]
