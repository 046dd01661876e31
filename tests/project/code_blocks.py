"""The code of the pages: blocks of Python, and the commands of indented blocks.

What can't run everywhere says so in a comment before it, in one of two forms:

    <!-- needs: h5py, torch -->      runs where these modules can be imported
    <!-- not run: the reason -->     never runs; commands are parsed all the same
"""

from __future__ import annotations

import importlib.util
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from helpers import ROOT

PYTHON = re.compile(r"^```python\n(?P<python>.*?)^```", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"(?:(?<=\n\n)|\A)(?P<indented>(?: {4}[^\n]*\n|\n(?= {4}))+)")
EITHER = re.compile(f"{PYTHON.pattern}|{INDENTED.pattern}", re.MULTILINE | re.DOTALL)
COMMENT = re.compile(r"<!--([^>]*)-->\s*\Z")
COMMAND = re.compile(r"(?:\$ )?(?:[A-Z_]+=\S+ )*(?P<words>(?:elf-[a-z]+|python) .*)")


@dataclass(frozen=True)
class Block:
    """A block of Python, or the commands of an indented block, and why it does not run here ("" where it does)."""

    page: str
    line: int
    python: str
    commands: tuple[tuple[str, ...], ...]
    left_out: str

    @property
    def place(self) -> str:
        return f"{self.page}:{self.line}"


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


def commands_of(text: str) -> Iterator[tuple[str, ...]]:
    """The words of the commands in an indented block that are ours, or Python's; pipes and comments left out."""
    for line in re.sub(r"\\\n\s*", "", re.sub(r"^ {4}", "", text, flags=re.MULTILINE)).splitlines():
        match = COMMAND.fullmatch(line)
        if match:
            words = shlex.split(match["words"], comments=True)
            ends = [i for i, word in enumerate(words) if word in ("|", ">", "&&", ";")]
            yield tuple(words[: ends[0]] if ends else words)


def blocks_in(page: str, text: str) -> list[Block]:
    found = []
    for match in EITHER.finditer(text):
        line = text.count("\n", 0, match.start()) + 1
        comment = COMMENT.search(text[: match.start()])
        try:
            left_out = reason_of(comment[1]) if comment else ""
        except ValueError as error:
            raise ValueError(f"{page}:{line}: {error}") from None
        commands = tuple(commands_of(match["indented"])) if match["indented"] else ()
        if match["python"] or commands:
            found.append(Block(page, line, match["python"] or "", commands, left_out))
    return found


def blocks_of(page: str) -> list[Block]:
    """The blocks of a page, named by its path in the project."""
    return blocks_in(page, (ROOT / page).read_text(encoding="utf-8"))


def pages() -> list[str]:
    """All pages whose code a user may copy."""
    found: list[Path] = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]
    found += [ROOT / folder / "README.md" for folder in ("models", "evaluation", "examples", "demo")]
    return sorted(path.relative_to(ROOT).as_posix() for path in found)
