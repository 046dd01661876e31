"""Pictures of matches."""

from __future__ import annotations

from elf_eval.report.pictures import _title


def test_a_match_picture_s_title_is_never_cut():
    """The last words of a long title are on a line of their own, and no line touches the right edge."""
    short, long = _title("SIFT: 5 and 5 keypoints", 324), _title("a method " * 12 + ": 5 and 5 keypoints", 324)
    assert long.shape[0] > short.shape[0]
    assert (long[:, -8:] == 255).all()
    assert (short[:, :200] < 128).any()
    assert _title("méthode ☃", 324).shape == short.shape
