"""Pictures of matches."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from elf_eval.data import Pair
from elf_eval.data.images import ImageRef
from elf_eval.data.truth import Homography
from elf_eval.features import ImageFeatures, LocalFeatures
from elf_eval.protocol import Protocol
from elf_eval.report.pictures import _title, draw_matches
from helpers import textured


def test_a_match_picture_s_title_is_never_cut():
    """The last words of a long title are on a line of their own, and no line touches the right edge."""
    short, long = _title("SIFT: 5 and 5 keypoints", 324), _title("a method " * 12 + ": 5 and 5 keypoints", 324)
    assert long.shape[0] > short.shape[0]
    assert (long[:, -8:] == 255).all()
    assert (short[:, :200] < 128).any()
    assert _title("méthode ☃", 324).shape == short.shape


@pytest.mark.parametrize("refine", [False, True])
def test_matches_are_drawn_where_they_were_measured(refine, tmp_path):
    """A match of a grey image with itself that is 1.5 pixels off: wrong by more than 0.5, unless it is refined."""
    image = cv2.cvtColor(textured(120, 160, channels=1), cv2.COLOR_GRAY2BGR)
    places = ((60.0, 50.0), (61.5, 50.0))
    first, second = (
        ImageFeatures(LocalFeatures.build([place], 1.0, np.ones((1, 4))), (160, 120), np.eye(3), 0.0)
        for place in places
    )
    pair = Pair("a", *(ImageRef(name, tmp_path / name) for name in ("1.png", "2.png")), Homography())
    protocol = Protocol(size=None, eps=0.5, refine=refine)
    drawn = draw_matches(image, image, first, second, pair, protocol, "SIFT")
    greener = drawn[..., 1].astype(int) - drawn[..., 2]
    assert ((greener > 60).sum() > 100, (greener < -60).sum() > 100) == (refine, not refine)
