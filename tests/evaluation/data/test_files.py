"""Names of scenes by their folders."""

from __future__ import annotations

import cv2
from scenes import pairs_line, photograph, write_strecha

from elf_eval.data import open_dataset


def test_a_flat_folder_is_called_by_its_name(tmp_path, monkeypatch):
    write_strecha(tmp_path / "wall", depth=False)
    for name in "ab":
        cv2.imwrite(str(tmp_path / "wall" / f"{name}.png"), photograph(ord(name)))
    (tmp_path / "wall" / "pairs.txt").write_text(pairs_line())
    monkeypatch.chdir(tmp_path / "wall")
    for text in ("pairs:pairs.txt", f"pairs:pairs.txt?images={tmp_path / 'wall'}", "webcam:."):
        assert open_dataset(text).scenes() == ["wall"]
    for name in "ab":
        (tmp_path / "wall" / f"{name}.png").unlink()
    assert open_dataset("strecha:.").scenes() == ["wall"]
    assert open_dataset("strecha:.").pairs[0].first.name == "wall/0000.png"
