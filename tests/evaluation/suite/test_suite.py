"""Suites that are damaged."""

from __future__ import annotations

import pytest

from elf_eval.command.main import main


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("[[method]]\nname='a'\ndetector='sift'", "at least one method and one dataset"),
        ("[[method]]\nname='a'\n[[dataset]]\nname='d'\nspec='x'", "detector"),
        ("speed = 3", "unknown ['speed']"),
        ("[protocol]\nsize = 3\n", "size"),
        ("[protocol]\nepsilon = 3\n", "epsilon"),
        ("[[table", "Expected"),
    ],
)
def test_a_damaged_suite_is_named(tmp_path, capsys, content, words):
    path = tmp_path / "s.toml"
    path.write_text(content)
    assert main(["run", str(path), "--out", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert words in error
    assert "s.toml" in error
