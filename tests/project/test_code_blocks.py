"""The code of the pages runs, page by page from top to bottom, and every command that a page shows can be parsed."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import pytest

from helpers import ROOT
from project.code_blocks import blocks_in, blocks_of, pages

# Pages whose Python other tests run, and look at what it finds.
ELSEWHERE = {
    "README.md": "tests/project/test_readme.py",
    "docs/usage.md": "tests/project/test_readme.py",
    "docs/library.md": "tests/export/test_library.py",
}
# Pages whose commands run as well, between the blocks of Python, and what the whole page needs.  The commands of other
# pages are parsed only.
TOP_TO_BOTTOM: dict[str, tuple[str, ...]] = {
    "docs/first-hour.md": (),
    "docs/export-your-network.md": ("torch", "onnx"),
}
SCRIPTS = dict(re.findall(r'^(elf-\w+) = "([\w.]+):main"', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.M))
PARSERS = {
    "elf-export": "elf_export.command.options:parser",
    "elf-detect": "elf_runtime.commands.detect_options:build_parser",
}
RUNNABLE = sorted(
    page
    for page in pages()
    if page not in ELSEWHERE and (page in TOP_TO_BOTTOM or any(block.python for block in blocks_of(page)))
)


def parser(command: str) -> Any:
    module, name = PARSERS.get(command, f"{SCRIPTS[command]}:build_parser").split(":")
    return getattr(importlib.import_module(module), name)()


def main_of(command: str) -> Callable[[list[str]], int]:
    return getattr(importlib.import_module(SCRIPTS[command]), "main")  # noqa: B009


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What a page's code finds around it: the project's folders, and photographs of its own."""
    for name in ("demo", "examples", "runtime"):
        (tmp_path / name).symlink_to(ROOT / name, target_is_directory=True)
    (tmp_path / "photos").mkdir()
    image = cv2.imread(str(ROOT / "demo" / "palace.jpg"))
    for i, name in enumerate("ab"):
        cv2.imwrite(str(tmp_path / "photos" / f"{name}.jpg"), image[10 * i : 400 + 10 * i, 30 * i : 560 + 30 * i])
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def quick_exports(monkeypatch: pytest.MonkeyPatch) -> None:
    """An export verifies itself on fewer images and directions; tests/export has the exporter's own."""
    if importlib.util.find_spec("onnx"):
        from elf_export.checks import directional, trial
        from elf_export.sources.sizes import free

        monkeypatch.setattr(directional, "DIRECTIONS", 1)
        monkeypatch.setattr(free, "LONG", 256)
        monkeypatch.setattr(trial, "AT", trial.AT[:1])


def names_for(page: str) -> dict[str, Any]:
    """What the page leaves to the reader."""
    if page != "docs/pipelines.md":
        return {}
    from elf_runtime import ElfRuntime, Matches

    elf = ElfRuntime()
    a, b = elf.detect("photos/a.jpg"), elf.detect("photos/b.jpg")
    return {"a": a, "b": b, "matches": Matches.between(a, b)}


def run_command(words: tuple[str, ...], place: str) -> None:
    if words[0] == "python":
        env = {**os.environ, "PYTHONPATH": str(ROOT / "runtime")}
        done = subprocess.run([sys.executable, *words[1:]], env=env, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{place}: {done.stderr}"
        return
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        status = main_of(words[0])(list(words[1:]))
    assert status == 0, f"{place}: {' '.join(words)}\n{said.getvalue()}"


@pytest.mark.usefixtures("quick_exports")
@pytest.mark.parametrize("page", RUNNABLE)
def test_the_code_of_a_page_runs(page: str, folder: Path) -> None:
    for module in TOP_TO_BOTTOM.get(page, ()):
        pytest.importorskip(module)
    names, ran = names_for(page), 0
    for block in blocks_of(page):
        if block.left_out:
            print(f"{block.place}: not run: {block.left_out}")
        elif block.python:
            exec(compile("\n" * block.line + block.python, page, "exec"), names)
            ran += 1
        elif page in TOP_TO_BOTTOM:
            for words in block.commands:
                run_command(words, block.place)
                ran += 1
    if not ran:
        pytest.skip("; ".join(sorted({block.left_out for block in blocks_of(page) if block.left_out})))


@pytest.mark.parametrize("page", [page for page in pages() if any(block.commands for block in blocks_of(page))])
def test_the_commands_of_a_page_can_be_parsed(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    for block in blocks_of(page):
        for words in block.commands:
            if words[0] == "python":
                script = ROOT / words[1]
                assert words[1].startswith("-") or script.is_file(), f"{block.place}: no {words[1]}"
                continue
            if "--print-completion" in words and importlib.util.find_spec("shtab") is None:
                continue
            try:
                parser(words[0]).parse_args(list(words[1:]))
            except SystemExit as ended:
                assert ended.code == 0, f"{block.place}: {' '.join(words)}: {capsys.readouterr().err}"  # noqa: PT017


def test_pages_that_other_tests_run_are_named_there() -> None:
    for page, test in ELSEWHERE.items():
        assert Path(page).name in (ROOT / test).read_text(encoding="utf-8")
        assert not any(block.left_out for block in blocks_of(page) if block.python)


@pytest.mark.parametrize("comment", ["skip", "not run", "not run: ", "needs: ", "needs: a b", "needs torch"])
def test_a_block_can_t_be_left_out_without_a_reason(comment: str) -> None:
    with pytest.raises(ValueError, match=r"^p\.md:3: .*neither"):
        blocks_in("p.md", f"<!-- {comment} -->\n\n```python\n1\n```\n")


def test_what_blocks_are() -> None:
    text = (
        "# Page\n\n    $ elf-detect a.jpg -o out | tee log  # writes out\n"
        "    A=1 elf-info \\\n        --json\n    other\n\n"
        "text\n    elf-info continued\n\n<!-- needs: no_such_module -->\n```python\nx = 1\n```\n\n"
        "<!-- not run: long -->\n\n    python tools/x.py 'a b'\n"
    )
    detect, code, tool = blocks_in("p.md", text)
    assert detect.commands == (("elf-detect", "a.jpg", "-o", "out"), ("elf-info", "--json"))
    assert (code.python, code.left_out, code.line) == ("x = 1\n", "no_such_module can't be imported", 12)
    assert (tool.commands, tool.left_out) == ((("python", "tools/x.py", "a b"),), "long")
