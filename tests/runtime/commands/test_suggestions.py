"""What a word that is not known may have meant."""

from __future__ import annotations

from pathlib import Path

import pytest

from elf_runtime.commands import detect, match, view


@pytest.mark.parametrize("given", ["--json", "--kind", "--pairs"])
def test_options_are_not_alike_for_their_hyphens(given: str, capsys: pytest.CaptureFixture[str]) -> None:
    """These are not elf-view's, and nothing of its is near."""
    with pytest.raises(SystemExit):
        view.main(["folder", given])
    assert "did you mean" not in capsys.readouterr().err


@pytest.mark.parametrize("given", [["--out", "z"], ["--out=z"]])
def test_a_word_near_to_an_option_that_is_required_is_named(
    given: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        detect.main(["few", *given])
    wanted = "required: -o/--output (--out is unknown; did you mean '--output'?)"
    assert wanted in capsys.readouterr().err
    with pytest.raises(SystemExit):
        detect.main(["few", "--mask", "m.png"])
    assert capsys.readouterr().err.endswith("required: -o/--output\n")


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("nearst:3", "nearest"),
        ("sequental", "sequential"),
        ("exhaustiv", "exhaustive"),
        ("nearest:x", None),
        ("z", None),
    ],
)
def test_the_nearest_rule_of_pairs_is_suggested(
    given: str, meant: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert match.main([str(tmp_path), "--pairs", given]) == 2
    error = capsys.readouterr().err
    assert error.endswith(f"of this name; did you mean {meant!r}?\n" if meant else "no file of this name\n")
