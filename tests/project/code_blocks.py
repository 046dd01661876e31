"""The code of the pages: fenced and indented blocks, in lists too, and the commands in them and in running text.

A fence says its language: `python` runs, `sh` holds commands, and `text` what a program prints.  An indented block
holds commands; where they begin with `$`, the other lines are what they print.  What can't run everywhere says so in a
comment before it, in one of two forms:

    <!-- needs: h5py, torch -->      runs where these modules can be imported
    <!-- not run: the reason -->     never runs; commands are parsed all the same
"""

from __future__ import annotations

import importlib.util
import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass

from helpers import ROOT
from project.shell_words import commands_of

LANGUAGES = ("python", "sh", "text", "diff", "cpp")
FENCE = re.compile(r" *(?P<marks>`{3,}|~{3,})(?P<language>.*)")
IN_PYTHON = re.compile(r"(?:from|import) \w|>>> ")
COMMENT = re.compile(r"<!--([^>]*)-->\s*\Z")
SPAN = re.compile(r"(`+)(?P<code>(?:(?!\1).)+)\1")
FOLDERS = ("docs", "models", "evaluation", "examples", "demo", "web", "export")


@dataclass(frozen=True)
class Block:
    """A block of Python or of commands, and why it does not run here ("" where it does)."""

    page: str
    line: int
    python: str
    commands: tuple[tuple[str, ...], ...]
    output: tuple[str, ...]
    left_out: str

    @property
    def place(self) -> str:
        return f"{self.page}:{self.line}"


@dataclass(frozen=True)
class Piece:
    """The text of a block without its indentation; `language` is None where it is indented only."""

    line: int
    language: str | None
    text: str


def reason_of(comment: str) -> str:
    """Why a block with this comment before it does not run here.

    Raises
    ------
    ValueError
        On a comment of another form.
    """
    kind, _, text = comment.strip().partition(": ")
    if kind == "not run" and text.strip():
        return text.strip()
    if kind == "needs" and re.fullmatch(r"\w+(, \w+)*", text):
        missing = [name for name in text.split(", ") if importlib.util.find_spec(name) is None]
        return f"{', '.join(missing)} can't be imported" if missing else ""
    raise ValueError(f"<!--{comment}-->: neither <!-- needs: MODULE, ... --> nor <!-- not run: REASON -->")


def is_code(lines: list[str], start: int) -> bool:
    """Whether the indented lines at `start` are code and no paragraph of a list's item, which has four spaces."""
    outside = next((line for line in lines[start::-1] if line.strip() and not line.startswith("    ")), "")
    return lines[start].startswith(" " * 6) or not re.match(r" |([-*+]|\d+[.)]) ", outside)


def pieces(lines: list[str]) -> Iterator[Piece]:
    """The blocks of a page as they stand there, from top to bottom."""
    i = 0
    while i < len(lines):
        start, fence = i, FENCE.fullmatch(lines[i])
        i += 1
        if fence:
            while i < len(lines) and lines[i].strip() != fence["marks"]:
                i += 1
            yield Piece(start + 1, fence["language"], textwrap.dedent("\n".join([*lines[start + 1 : i], ""])))
            i += 1
        elif lines[start].startswith("    ") and (start == 0 or not lines[start - 1].strip()):
            while i < len(lines) and re.match(r" {4}|\s*\Z", lines[i]) and not FENCE.fullmatch(lines[i]):
                i += 1
            if is_code(lines, start):
                yield Piece(start + 1, None, textwrap.dedent("\n".join([*lines[start:i], ""])))


def checked(piece: Piece) -> Piece:
    """The block itself; a ValueError where nobody could tell what it holds."""
    if piece.language is not None and piece.language not in LANGUAGES:
        raise ValueError(f"a fence says {' or '.join(LANGUAGES)}, not {piece.language!r}")
    if piece.language in (None, "sh", "text") and IN_PYTHON.match(piece.text):
        raise ValueError("Python is in a fence that says python")
    return piece


def blocks_in(page: str, text: str) -> list[Block]:
    found = []
    lines = text.splitlines()
    for piece in pieces(lines):
        comment = COMMENT.search("\n".join(lines[: piece.line - 1]))
        try:
            language = checked(piece).language
            left_out = reason_of(comment[1]) if comment else ""
        except ValueError as error:
            raise ValueError(f"{page}:{piece.line}: {error}") from None
        commands, output = commands_of(piece.text) if language in (None, "sh") else ([], [])
        if language == "python" or commands:
            python = piece.text if language == "python" else ""
            found.append(Block(page, piece.line, python, tuple(commands), tuple(output), left_out))
    return found


def blocks_of(page: str) -> list[Block]:
    """The blocks of a page, named by its path in the project."""
    return blocks_in(page, (ROOT / page).read_text(encoding="utf-8"))


def spans_in(text: str) -> Iterator[tuple[int, bool, tuple[str, ...]]]:
    """Our commands with arguments in running text and in tables: line, whether it is whole, and words.

    Whole are those that a row begins with, and those of a column that is called command.
    """
    lines = text.splitlines()
    inside = {n for piece in pieces(lines) for n in range(piece.line - 1, piece.line + piece.text.count("\n"))}
    header: list[str] = []  # of the table that the line is in
    for n, line in enumerate(lines):
        header = (header or [cell.strip() for cell in line.split("|")]) if line.startswith("|") else []
        for match in SPAN.finditer("" if n in inside else line):
            column = len(re.findall(r"(?<!\\)\|", line[: match.start()]))
            whole = bool(re.fullmatch(r"\| *", line[: match.start()])) or header[column : column + 1] == ["command"]
            for words in commands_of(match["code"].replace("\\|", "|"))[0]:
                if len(words) > 1 and words[0].startswith("elf-"):
                    yield n + 1, whole, words


def pages() -> list[str]:
    """All pages whose code a user may copy."""
    found = [*ROOT.glob("*.md"), *(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.md"))]
    return sorted(path.relative_to(ROOT).as_posix() for path in found if "node_modules" not in path.parts)
