"""Relative links and anchors of all Markdown files lead somewhere, and so do the pages that code and commands name."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from urllib.parse import unquote

import pytest

from helpers import ROOT

ELSEWHERE = {
    "out",
    "build",
    "dist",
    "node_modules",
}  # what git ignores; folders of installed packages begin with a dot
HIDDEN = {".github"}
OTHERS = {"docs/operators.md", "docs/OperatorKernels.md"}  # of onnx-tensorrt and of ONNX Runtime
PAGE = re.compile(r"\b(?:docs|models|evaluation|examples|demo)/(?:[\w-]+/)*[\w-]+\.md\b")


def files(*suffixes: str, folder: Path = ROOT) -> Iterator[Path]:
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            if path.name in HIDDEN or not (path.name.startswith(".") or path.name in ELSEWHERE):
                yield from files(*suffixes, folder=path)
        elif path.suffix in suffixes:
            yield path


def prose(file: Path) -> str:
    """A page without its code, which may hold brackets and lines that look like headings."""
    text = re.sub(r"^(```+).*?^\1", "", file.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"(?:^|(?<=\n\n))(?: {4}.*\n?)+", "", text)


@cache
def anchors(file: Path) -> set[str]:
    """The headings' anchors, as GitHub makes them: the second of a name gets a number."""
    found: set[str] = set()
    for heading in re.findall(r"^#+ +(.*?) *$", prose(file), re.MULTILINE):
        shown = re.sub(r"!?\[([^]]*)\]\([^)]*\)", r"\1", heading)
        name = re.sub(r"[^\w\- ]", "", shown.lower()).replace(" ", "-")
        same = (f"{name}-{i}" if i else name for i in range(1000))
        found.add(next(anchor for anchor in same if anchor not in found))
    return found


def broken(file: Path) -> list[str]:
    """The targets of `file`'s relative links that do not exist."""
    text = re.sub(r"`[^`\n]*`", "", prose(file))
    targets = re.findall(r"\]\(\s*<?([^)\s>]+)", text) + re.findall(r"^\[[^]]+\]: +(\S+)", text, re.MULTILINE)
    return [target for target in targets if not re.match(r"[a-z]+:", target) and not resolves(file, target)]


def resolves(file: Path, target: str) -> bool:
    path, _, anchor = target.partition("#")
    there = file.parent / unquote(path) if path else file
    return there.exists() and (not anchor or anchor in anchors(there))


@pytest.mark.parametrize("file", list(files(".md")), ids=lambda path: path.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(file: Path) -> None:
    assert broken(file) == []


def test_pages_that_code_names_are_there() -> None:
    sources = [ROOT / "Makefile", *files(".py", ".c", ".mjs", ".toml", ".yml", ".yaml")]
    named = [(source, page) for source in sources for page in PAGE.findall(source.read_text(encoding="utf-8"))]
    ours = [(source, page) for source, page in named if source != Path(__file__) and page not in OTHERS]
    missing = [
        f"{source.relative_to(ROOT)}: {page}"
        for source, page in ours
        if not (ROOT / page).exists() and not (source.parent / page).exists()
    ]
    assert len(ours) > 5
    assert missing == []


def test_what_leads_nowhere_is_found(tmp_path: Path) -> None:
    page, other = tmp_path / "page.md", tmp_path / "other.md"
    other.write_text("# C++ and `x`\n\n## Twice\n\n## Twice\n\n```\n# no heading\n```\n", encoding="utf-8")
    good = [
        "other.md",
        "other.md#c-and-x",
        "other.md#twice",
        "other.md#twice-1",
        "#top",
        "https://example.org/x",
    ]
    bad = ["gone.md", "other.md#twice-2", "other.md#no-heading", "#bottom", "gone.png"]
    links = "\n".join(f"[text]({target})" for target in good + bad)
    code = "`[code](gone.md)`\n\n    [code](gone.md)"
    page.write_text(f"# Top\n\n{links}\n\n{code}\n\n[ref]: gone.txt\n", encoding="utf-8")
    assert broken(page) == [*bad, "gone.txt"]
