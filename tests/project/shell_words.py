"""Our commands among the lines of a shell, and the options that their parsers know."""

from __future__ import annotations

import argparse
import re
import shlex

PROMPT = "$ "
STARTS = re.compile(r"(?:\A|[|&;] *)(?:[A-Z_]+=\S+ +)*(?:\S*/)?(?:elf-|python)")


def _segments(line: str) -> list[list[str]]:
    """The words of each command of a line; what stands behind > and < is left out."""
    reader = shlex.shlex(line, posix=True, punctuation_chars="|&;<>")
    reader.whitespace_split = True
    found: list[list[str]] = [[]]
    redirected = False
    for word in reader:
        if re.fullmatch(r"[|&;]+", word):
            found.append([])
        elif re.fullmatch(r"[<>&]+", word):
            redirected = True
        elif redirected:
            redirected = False
        else:
            found[-1].append(word)
    return found


def _ours(words: list[str]) -> tuple[str, ...]:
    """The words from the command's name on if it is ours or Python, of any environment; else none."""
    while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):
        words = words[1:]
    name = words[0].rpartition("/")[2] if words else ""
    if re.fullmatch(r"elf-[a-z]+", name):
        return (name, *words[1:])
    return ("python", *words[1:]) if name in ("python", "python3") and len(words) > 1 else ()


def commands_of(text: str) -> tuple[list[tuple[str, ...]], list[str]]:
    """The words of our commands and of Python's in a block, and the lines that they print."""
    lines = re.sub(r"\\\n\s*", "", text).splitlines()
    prompted = any(line.startswith(PROMPT) for line in lines)
    commands, output = [], []
    for line in lines:
        if prompted and not line.startswith(PROMPT):
            output += [line] if line.strip() else []
        elif STARTS.search(line.removeprefix(PROMPT)):
            commands += [words for words in map(_ours, _segments(line.removeprefix(PROMPT))) if words]
    return commands, output


def options_of(parser: argparse.ArgumentParser, words: tuple[str, ...]) -> set[str]:
    """The options of a parser, and of that subcommand of it which the words name, or of all where they name none."""
    known = set(parser._option_string_actions)
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            named = [word for word in words if word in action.choices]
            for name in named[:1] or action.choices:
                known |= options_of(action.choices[name], words)
    return known
