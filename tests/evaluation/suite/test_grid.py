"""A sweep's grid."""

from __future__ import annotations

import pytest

from elf_eval.errors import EvalError
from elf_eval.suite.grid import parse_grid


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("nms_radius=4..7", ["4", "5", "6", "7"]),
        ("nms_radius=2/4..6/5", ["2", "4", "5", "6"]),
        ("scale=0.1..0.35..0.1", ["0.1", "0.2", "0.3"]),
        ("denoise=3..7..2,1", ["3,1", "5,1", "7,1"]),
        ("denoise=3..5..2,4..5/9,9", ["3,4", "3,5", "5,4", "5,5", "9,9"]),
        ("threshold=kapur/0.2..0.4..0.2", ["kapur", "0.2", "0.4"]),
        ("grid=1,1/4..5,6", ["1,1", "4,6", "5,6"]),
        ("min_contrast=0/1.5", ["0", "1.5"]),
        ("mask_border=auto/0", ["auto", "0"]),
        ("max_keypoints=100/200", ["100", "200"]),
    ],
)
def test_a_grid_takes_ranges(text, values):
    assert parse_grid([text]) == {text.partition("=")[0]: values}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("nms_radius=4..", "is not FROM..TO"),
        ("nms_radius=1..2..3..4", "is not FROM..TO"),
        ("nms_radius=a..b", "is not FROM..TO"),
        ("nms_radius=9..4", "goes upwards"),
        ("nms_radius=1..4..0", "a step above 0"),
        ("nms_radius=0..100000000000", "at most 1000"),
        ("nms_radius=1..2..0.5", "grid 'nms_radius=1..2..0.5'"),
        ("scale=9", r"grid 'scale=9': scale is a number in \(0, 8\], not 9"),
    ],
)
def test_a_range_that_is_none_is_named(text, words):
    with pytest.raises(EvalError, match=words):
        parse_grid([text])
