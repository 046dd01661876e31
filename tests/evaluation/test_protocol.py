"""The protocol's settings."""

from __future__ import annotations

import pytest

from elf_eval.errors import EvalError
from elf_eval.protocol import Protocol


@pytest.mark.parametrize("ratio", [0, 1.0, -0.5, float("nan")])
def test_a_ratio_that_is_none_is_refused(ratio):
    with pytest.raises(EvalError, match=r"protocol: ratio is a number in \(0, 1\), not"):
        Protocol(ratio=ratio)


@pytest.mark.parametrize("floor", [-1, 501, 2.5])
def test_a_floor_that_is_none_is_refused(floor):
    with pytest.raises(EvalError, match="count_floor is a whole number from 0 to max_keypoints"):
        Protocol(count_floor=floor)


def test_whether_matches_are_refined_is_true_or_false():
    assert [Protocol.from_dict(data).refine for data in ({}, {"refine": True}, {"refine": False})] == [
        False,
        True,
        False,
    ]
    with pytest.raises(EvalError, match="protocol: refine: expected true or false, found 'yes'"):
        Protocol.from_dict({"refine": "yes"})
