"""SuperGlue's lists of calibrated pairs."""

from __future__ import annotations

import cv2
import pytest
from scenes import between, pairs_line, photograph

from elf_eval.data import open_dataset
from elf_eval.errors import EvalError


def test_a_list_of_posed_pairs(tmp_path):
    for name in "ab":
        cv2.imwrite(str(tmp_path / f"{name}.png"), photograph(ord(name)))
    (tmp_path / "pairs.txt").write_text(pairs_line())
    (pair,) = open_dataset(f"pairs:{tmp_path / 'pairs.txt'}").pairs
    assert between(pair).pose.translation.tolist() == [1, 0, 0]
    (tmp_path / "pairs.txt").write_text("a.png b.png 0 0\n")
    with pytest.raises(EvalError, match=r"pairs\.txt:1: expected 38 fields"):
        open_dataset(f"pairs:{tmp_path / 'pairs.txt'}")
    (tmp_path / "b.png").unlink()
    (tmp_path / "pairs.txt").write_text(pairs_line())
    with pytest.raises(EvalError, match=r"no such image.*b\.png"):
        open_dataset(f"pairs:{tmp_path / 'pairs.txt'}")
