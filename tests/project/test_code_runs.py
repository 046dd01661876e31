"""The code of the pages runs, page by page from top to bottom, and its commands print what the page shows."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import io
import os
import re
import shutil
import subprocess
import sys
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from helpers import ROOT
from project.code_blocks import Block, blocks_of, pages
from project.test_code_blocks import SCRIPTS

# Pages whose Python other tests run, and look at what it finds.
ELSEWHERE = {
    "README.md": "tests/project/test_readme.py",
    "docs/usage.md": "tests/project/test_readme.py",
    "docs/library.md": "tests/export/test_library.py",
}
# Pages whose commands run as well, between the blocks of Python, and what the whole page needs.  The commands of other
# pages are parsed only.
TOP_TO_BOTTOM: dict[str, tuple[str, ...]] = {
    "docs/commands.md": (),
    "docs/detection.md": (),
    "docs/embedded.md": (),
    "docs/export-your-network.md": ("torch", "onnx"),
    "docs/first-hour.md": (),
}
RUNNABLE = sorted(
    page
    for page in pages()
    if page not in ELSEWHERE and (page in TOP_TO_BOTTOM or any(block.python for block in blocks_of(page)))
)
NUMBER = re.compile(r"\d+(?:\.\d+)?")
TIME_OR_ROUNDING = re.compile(r"\d+(?:\.\d+)?(?: s\b|e[+-]\d+)")


def main_of(command: str) -> Callable[[list[str]], int]:
    return getattr(importlib.import_module(SCRIPTS[command]), "main")  # noqa: B009


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What a page's code finds around it: the project's folders, and photographs, a mask and a model of its own."""
    for name in ("demo", "examples", "runtime"):
        (tmp_path / name).symlink_to(ROOT / name, target_is_directory=True)
    (tmp_path / "photos").mkdir()
    image = cv2.imread(str(ROOT / "demo" / "palace.jpg"))
    for i, name in enumerate("ab"):
        cv2.imwrite(str(tmp_path / "photos" / f"{name}.jpg"), image[10 * i : 400 + 10 * i, 30 * i : 560 + 30 * i])
    cv2.imwrite(str(tmp_path / "photo.png"), image)
    cv2.imwrite(str(tmp_path / "mask.png"), np.full(image.shape[:2], 255, np.uint8))
    shutil.copy(ROOT / "runtime" / "elf_runtime" / "models" / "elf-vgg.onnx", tmp_path / "model.onnx")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(webbrowser, "open", lambda *_, **__: True)
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
    if page == "docs/commands.md":  # it says that `make demo` makes it
        Path("out/demo").mkdir(parents=True)
        run_command(("python", "demo/second_view.py", "demo/palace.jpg", "out/demo/view.png"), page)
    if page != "docs/pipelines.md":
        return {}
    from elf_runtime import ElfRuntime, Matches

    elf = ElfRuntime()
    a, b = elf.detect("photos/a.jpg"), elf.detect("photos/b.jpg")
    return {"a": a, "b": b, "matches": Matches.between(a, b)}


def run_command(words: tuple[str, ...], place: str) -> str:
    """What the command prints; it has to end with status 0."""
    if words[0] == "python":
        env = {**os.environ, "PYTHONPATH": str(ROOT / "runtime")}
        done = subprocess.run([sys.executable, *words[1:]], env=env, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{place}: {done.stderr}"
        return done.stdout
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            status = main_of(words[0])(list(words[1:]))
    except SystemExit as ended:
        status = int(ended.code or 0)
    assert status == 0, f"{place}: {' '.join(words)}\n{said.getvalue()}"
    return said.getvalue()


def same(shown: str, printed: str) -> bool:
    """Whether a line is what the page shows: numbers to a twentieth, as processors differ; times and errors aside."""
    a, b = (TIME_OR_ROUNDING.sub("?", line.strip()) for line in (shown, printed))
    if NUMBER.sub("?", a) != NUMBER.sub("?", b):
        return False
    return bool(np.allclose(*(np.array(NUMBER.findall(line), float) for line in (b, a)), rtol=0.05, atol=0.05))


def check_output(block: Block, said: str) -> None:
    """Each line that the page shows is printed, in this order; "..." stands for any lines, within one for anything."""
    printed = iter(said.splitlines())
    for shown in block.output:
        if "..." not in shown:
            assert any(same(shown, line) for line in printed), f"{block.place}: not printed: {shown}\n{said}"


def run_block(block: Block, page: str, names: dict[str, Any]) -> int:
    """How many pieces of code were run."""
    if block.left_out:
        print(f"{block.place}: not run: {block.left_out}")
        return 0
    if block.python:
        exec(compile("\n" * block.line + block.python, page, "exec"), names)
        return 1
    if page not in TOP_TO_BOTTOM:
        return 0
    check_output(block, "".join(run_command(words, block.place) for words in block.commands))
    return len(block.commands)


@pytest.mark.usefixtures("folder", "quick_exports")
@pytest.mark.parametrize("page", RUNNABLE)
def test_the_code_of_a_page_runs(page: str) -> None:
    for module in TOP_TO_BOTTOM.get(page, ()):
        pytest.importorskip(module)
    names = names_for(page)
    if not sum(run_block(block, page, names) for block in blocks_of(page)):
        pytest.skip("; ".join(sorted({block.left_out for block in blocks_of(page) if block.left_out})))


def test_pages_that_other_tests_run_are_named_there() -> None:
    for page, test in ELSEWHERE.items():
        assert Path(page).name in (ROOT / test).read_text(encoding="utf-8")
        assert not any(block.left_out for block in blocks_of(page) if block.python)


@pytest.mark.parametrize(
    ("shown", "printed", "wanted"),
    [
        ("a: 500 keypoints, 0.07 s -> b", "a: 490 keypoints, 3.2 s -> b", True),
        ("a: 500 keypoints, 0.07 s -> b", "a: 400 keypoints, 0.07 s -> b", False),
        ("error 6.4e-08  100.0%", "error 2.1e-08  99.9%", True),
        ("a: 500 keypoints", "b: 500 keypoints", False),
        ("a: 500 keypoints", "a: 500 keypoints, 3 matches", False),
    ],
)
def test_what_a_page_shows_is_compared(shown: str, printed: str, wanted: bool) -> None:
    assert same(shown, printed) == wanted


def test_a_line_that_is_not_printed_is_told() -> None:
    block = Block("p.md", 3, "", (), ("a 1", "...", "b 20"), "")
    check_output(block, "a 1\nx\nb 20\n")
    with pytest.raises(AssertionError, match=r"p\.md:3: not printed: b 20"):
        check_output(block, "a 1\nb 30\n")
    with pytest.raises(AssertionError, match=r"p\.md:3: not printed: b 20"):
        check_output(block, "b 20\na 1\n")
