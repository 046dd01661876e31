"""The site of the documentation: links that leave docs/, and its navigation.  `make docs` builds it strictly."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any

import pytest

from helpers import ROOT

HOOKS: dict[str, Any] = runpy.run_path(str(ROOT / "tools" / "docs_hooks.py"))
DOCS = ROOT / "docs"
CONFIGURATION = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
NAVIGATION = re.findall(r"^ +- [^:\n]+: (\S+\.md)$", CONFIGURATION, re.MULTILINE)


@pytest.mark.parametrize(
    ("page", "link", "wanted"),
    [
        ("docs/usage.md", "quality.md#quality", "quality.md#quality"),
        ("docs/usage.md", "images/matches.png", "images/matches.png"),
        ("docs/usage.md", "../README.md", "project/README.md"),
        ("docs/usage.md", "../models/README.md#cards", "project/models/README.md#cards"),
        ("docs/usage.md", "../models", "project/models/README.md"),
        ("docs/usage.md", "../runtime/elf_runtime/params.py", "project/runtime/elf_runtime/params.py.md"),
        ("docs/usage.md", "../export/elf_export/checks", "project/export/elf_export/checks/index.md"),
        ("docs/usage.md", "../examples/notebooks/first_hour.ipynb", "project/examples/notebooks/first_hour.ipynb"),
        ("CONTRIBUTING.md", ".github/workflows/ci.yml", "github/workflows/ci.yml.md"),
        ("models/README.md", "../docs/quality.md", "../../quality.md"),
        ("models/README.md", "../evaluation/README.md", "../evaluation/README.md"),
        ("docs/usage.md", "https://example.org/docs/usage.md", "https://example.org/docs/usage.md"),
        ("docs/usage.md", "../gone.md", "../gone.md"),
        ("docs/usage.md", "../../../etc/hosts", "../../../etc/hosts"),
        ("docs/usage.md", "#presets-and-settings", "#presets-and-settings"),
    ],
)
def test_links_as_they_are_in_the_site(page: str, link: str, wanted: str) -> None:
    assert HOOKS["rewritten"](f"See [a page]({link}).", ROOT / page) == f"See [a page]({wanted})."


def test_what_a_page_links_to_is_in_the_site() -> None:
    outside = HOOKS["outside"]()
    assert {"CHANGELOG.md", "CONTRIBUTING.md", "models/README.md"} <= {str(path.relative_to(ROOT)) for path in outside}
    for page in (*DOCS.rglob("*.md"), *(path for path in outside if path.suffix == ".md" or path.is_dir())):
        for _, path in HOOKS["targets"](HOOKS["content"](page), page):
            assert path in outside or path.is_relative_to(DOCS)
    places = [HOOKS["place"](path) for path in outside]
    assert len(set(places)) == len(places)


def test_a_source_file_becomes_a_page() -> None:
    text = HOOKS["content"](ROOT / "runtime" / "elf_runtime" / "params.py")
    assert "exclude: true" in text  # the search is for prose
    assert "# `runtime/elf_runtime/params.py`" in text
    assert "````python\n" in text


def test_the_navigation_has_every_page_once() -> None:
    assert len(set(NAVIGATION)) == len(NAVIGATION)
    assert {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")} <= set(NAVIGATION)
    elsewhere = {HOOKS["place"](path) for path in HOOKS["outside"]()}
    assert {page for page in NAVIGATION if not (DOCS / page).is_file()} <= elsewhere


def test_the_api_page_has_every_public_name() -> None:
    page = (DOCS / "api.md").read_text(encoding="utf-8")
    stated = re.findall(r"^::: (\S+)$", page, re.MULTILINE)
    assert len(set(stated)) == len(stated)
    stable = (DOCS / "stability.md").read_text(encoding="utf-8")
    functions = re.findall(r"^- `(elf_runtime\.\S+)`$", stable, re.MULTILINE)
    assert functions
    for package, source in (("elf_runtime", "runtime"), ("elf_export", "export")):
        text = (ROOT / source / package / "__init__.py").read_text(encoding="utf-8")
        (listed,) = re.findall(r"__all__ = \[(.*?)\]", text, re.DOTALL)
        assert {f"{package}.{name}" for name in re.findall(r'"(\w+)"', listed)} <= set(stated)
    assert set(functions) <= set(stated)


@pytest.mark.parametrize(
    ("github", "site", "said"),
    [
        (
            "<ul><li>a<pre><code>  x &lt; 1\n</code></pre></li></ul>",
            "<ul><li>a<p>x &lt; 1</p></li></ul>",
            "lost code 'x < 1'",
        ),
        ("<ul><li>a</li><li>b</li></ul>", "<ul><li>a - b</li></ul>", "1 <li>, not 2"),
        ("<p>a:</p><ul><li>b</li></ul>", "<p>a: - b</p>", "0 <ul>, not 1"),
        ("<ul><li>a<ul><li>b</li></ul></li></ul>", "<ul><li>a</li><li>b</li></ul>", "1 <ul>, not 2"),
        ("<p>a*b*</p>", "<p>a<em>b</em></p>", "1 <em>, not 0"),
        ("<ul><li>a<p>b</p></li></ul>", "<ul><li>a b</li></ul>", "0 <p>, not 1"),
        ("<ul><li>a<pre>x</pre></li></ul>", "<ul>\n<li>\n<p>a</p><pre><span>x</span></pre></li></ul>", ""),
    ],
)
def test_a_page_that_the_site_shows_otherwise_than_github_is_told(github: str, site: str, said: str) -> None:
    found = runpy.run_path(str(ROOT / "tools" / "docs_structure.py"))["differences"](github, site)
    assert said in found if said else not found


@pytest.mark.parametrize(
    ("html", "refused"),
    [
        ('<script src="https://cdn.example.org/a.js"></script>', True),
        ("<link rel=stylesheet href=//fonts.example.org/a.css>", True),
        ('<img alt="" src="http://example.org/a.png">', True),
        ('<script src="assets/a.js"></script><a href="https://example.org">there</a>', False),
    ],
)
def test_no_page_loads_from_another_server(html: str, refused: bool) -> None:
    assert bool(HOOKS["REQUEST"].findall(html)) == refused


def test_the_figures_can_be_drawn_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import cv2

    monkeypatch.setattr("sys.argv", ["draw_figures.py", "--out", str(tmp_path)])
    runpy.run_path(str(ROOT / "tools" / "draw_figures.py"), run_name="__main__")
    drawn, shown = (cv2.imread(str(folder / "pipeline.jpg")) for folder in (tmp_path, DOCS / "images"))
    assert drawn.shape == shown.shape
    # On another processor a keypoint or the ends of the colours may differ.
    assert float(cv2.absdiff(drawn, shown).mean()) < 4
