"""What the blocks of a page are; every command that a page shows can be parsed.  test_code_runs.py runs them."""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import re
from typing import Any

import pytest

from helpers import ROOT
from project.code_blocks import blocks_in, blocks_of, pages, spans_in
from project.shell_words import commands_of, options_of

SCRIPTS = dict(re.findall(r'^(elf-\w+) = "([\w.]+):main"', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.M))
PARSERS = {
    "elf-export": "elf_export.command.options:parser",
    "elf-detect": "elf_runtime.commands.detect_options:build_parser",
}


def parser(command: str) -> Any:
    module, name = PARSERS.get(command, f"{SCRIPTS[command]}:build_parser").split(":")
    return getattr(importlib.import_module(module), name)()


def check_command(words: tuple[str, ...], place: str, capsys: pytest.CaptureFixture[str]) -> None:
    if words[0] == "python":
        assert words[1].startswith("-") or (ROOT / words[1]).is_file(), f"{place}: no {words[1]}"
        return
    if "--print-completion" in words and importlib.util.find_spec("shtab") is None:
        return
    try:
        parser(words[0]).parse_args(list(words[1:]))
    except SystemExit as ended:
        assert ended.code == 0, f"{place}: {' '.join(words)}: {capsys.readouterr().err}"  # noqa: PT017


@pytest.mark.parametrize("page", pages())
def test_the_commands_of_a_page_can_be_parsed(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    for block in blocks_of(page):
        for words in block.commands:
            check_command(words, block.place, capsys)
    for line, whole, words in spans_in((ROOT / page).read_text(encoding="utf-8")):
        if whole:
            check_command(words, f"{page}:{line}", capsys)
        options = {word.partition("=")[0] for word in words if re.match(r"--?[a-zA-Z]", word)}
        unknown = options - options_of(parser(words[0]), words)
        assert not unknown, f"{page}:{line}: {words[0]} has no {', '.join(sorted(unknown))}"


@pytest.mark.parametrize("comment", ["skip", "not run", "not run: ", "needs: ", "needs: a b", "needs torch"])
def test_a_block_can_t_be_left_out_without_a_reason(comment: str) -> None:
    with pytest.raises(ValueError, match=r"^p\.md:3: .*neither"):
        blocks_in("p.md", f"<!-- {comment} -->\n\n```python\n1\n```\n")


@pytest.mark.parametrize(
    "text", ["```\nx\n```", "- a\n\n    ```\n    x\n    ```", "```py\nx\n```", "```Python\nx\n```", "~~~\nx\n~~~"]
)
def test_a_fence_says_what_it_holds(text: str) -> None:
    with pytest.raises(ValueError, match=r"^p\.md:\d: a fence says python or sh"):
        blocks_in("p.md", text)


@pytest.mark.parametrize("text", ["    import cv2\n", "    from cv2 import imread\n", "```text\n>>> 1\n```"])
def test_python_is_fenced(text: str) -> None:
    with pytest.raises(ValueError, match=r"^p\.md:1: Python is in a fence"):
        blocks_in("p.md", text)


def test_what_blocks_are() -> None:
    text = (
        "# Page\n\n    $ elf-detect a.jpg -o out | tee log  # writes out\n"
        "    $ A=1 elf-info \\\n        --json\n    elf-info says\n\n"
        "text\n    elf-info continued\n\n<!-- needs: no_such_module -->\n```python\nx = 1\n```\n\n"
        "<!-- not run: long -->\n\n    python tools/x.py 'a b'\n"
    )
    detect, code, tool = blocks_in("p.md", text)
    assert detect.commands == (("elf-detect", "a.jpg", "-o", "out"), ("elf-info", "--json"))
    assert detect.output == ("elf-info says",)
    assert (code.python, code.left_out, code.line) == ("x = 1\n", "no_such_module can't be imported", 12)
    assert (tool.commands, tool.left_out) == ((("python", "tools/x.py", "a b"),), "long")


def test_blocks_in_lists() -> None:
    text = (
        "- one\n\n    ```sh\n    elf-info a\n    ```\n\n    It's what `python -m x` says.\n\n"
        "- two\n\n        elf-info b\n\n"
        "1. three\n\n    <!-- not run: so -->\n    ```python\n    if x:\n        y\n    ```\n"
    )
    one, two, three = blocks_in("p.md", text)
    assert (one.commands, two.commands) == ((("elf-info", "a"),), (("elf-info", "b"),))
    assert (three.python, three.left_out, three.line) == ("if x:\n    y\n", "so", 16)


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("cd x && env/bin/elf-info a.onnx; B=1 elf-info b.onnx > c", [("elf-info", "a.onnx"), ("elf-info", "b.onnx")]),
        ("cat a | env/bin/python -m x 2>&1", [("python", "-m", "x", "2")]),
        ("elf-detect 'a;b' \"c d\" # elf-info", [("elf-detect", "a;b", "c d")]),
        ("pip install elf-onnx && ls elf-alone.onnx", []),
        ("view/ makes elf-view's page", []),
    ],
)
def test_commands_of_a_line(line: str, wanted: list[tuple[str, ...]]) -> None:
    assert commands_of(line) == (wanted, [])


def test_commands_in_running_text_and_tables() -> None:
    text = "| `elf-info a --json` | `elf-info b` |\nSay `elf-info`, ``elf-info c``.\n\n    `elf-info d`\n"
    assert list(spans_in(text)) == [
        (1, True, ("elf-info", "a", "--json")),
        (1, False, ("elf-info", "b")),
        (2, False, ("elf-info", "c")),
    ]


def test_commands_in_a_column_of_commands_are_whole() -> None:
    text = "| a | command | b |\n| - | - | - |\n| x | say `elf-info a`, `elf-info b` | `elf-info c` |\n\n`elf-info d`\n"
    assert [(words[1], whole) for _, whole, words in spans_in(text)] == [
        ("a", True),
        ("b", True),
        ("c", False),
        ("d", False),
    ]


def test_options_of_subcommands() -> None:
    parent = argparse.ArgumentParser()
    commands = parent.add_subparsers()
    commands.add_parser("run").add_argument("--fast")
    commands.add_parser("list").add_argument("--all")
    assert options_of(parent, ("run",)) == {"-h", "--help", "--fast"}
    assert options_of(parent, ()) == {"-h", "--help", "--fast", "--all"}
