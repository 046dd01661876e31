"""The Python of README and docs/usage.md runs as it stands, from a fresh clone after `pip install .`: without what
`make demo` writes.  What README says of commands and figures is what the pages behind it say."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers import ROOT
from project.code_blocks import blocks_of

PAGES = {name: (ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "docs/usage.md", "docs/quality.md")}


def run_the_blocks(page: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The names that the page's blocks of Python leave behind, run one by one beside the demo's photograph."""
    (folder / "demo").symlink_to(ROOT / "demo", target_is_directory=True)
    monkeypatch.chdir(folder)
    names: dict[str, Any] = {}
    for block in blocks_of(page):
        exec(block.python, names)
    return names


@pytest.mark.parametrize(("page", "second"), [("README.md", 483), ("docs/usage.md", 300)])
def test_the_python_runs_in_a_fresh_clone(
    page: str, second: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = run_the_blocks(page, tmp_path, monkeypatch)
    a, b, pairs = (names[name] for name in ("a", "b", "pairs"))
    assert (len(a), len(b)) == (500, second)
    assert a.keypoints.shape == (500, 2)
    assert a.descriptors.shape == (500, 128)
    assert pairs.shape[1] == 2
    # The second is a part of the first: what matches lies where it was cut out.
    shifts = a.keypoints[pairs[:, 0]] - b.keypoints[pairs[:, 1]]
    assert len(pairs) > 200
    np.testing.assert_allclose(np.median(shifts, axis=0), (60, 40), atol=0.5)
    np.testing.assert_allclose(
        names["view"].matrix / names["view"].matrix[2, 2], [[1, 0, -60], [0, 1, -40], [0, 0, 1]], atol=0.5
    )
    if page == "docs/usage.md":
        points, descriptors = names["points"], names["descriptors"]
        assert (len(points), descriptors.shape) == (500, (500, 128))


def test_readme_is_short() -> None:
    assert len(PAGES["README.md"].splitlines()) < 150


def test_readme_gives_the_rows_of_the_quality_page() -> None:
    def rows(page: str) -> set[str]:
        return {line for line in PAGES[page].splitlines() if re.match(r"\| .*\d+ \(\d+\) \|", line)}

    assert len(rows("README.md")) == 6
    assert rows("README.md") <= rows("docs/quality.md")


def test_readme_names_every_command() -> None:
    commands = re.findall(r"^\| `(elf-\w+) ", PAGES["README.md"], re.MULTILINE)
    declared = re.findall(r"^(elf-\w+) = ", (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(commands) == sorted(declared)
