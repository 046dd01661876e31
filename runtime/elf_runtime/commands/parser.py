"""The parser of every command: errors that suggest what was meant, JSON errors, ``--version`` and shell completion."""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from itertools import pairwise
from typing import Any, NoReturn

from elf_runtime import __version__
from elf_runtime.errors import suggestion

from .terminal import discard_stdout, flush_stdout, say

SHELLS = ("bash", "zsh", "tcsh")


class Parser(argparse.ArgumentParser):
    """A parser whose errors are JSON too, where the command line asks for JSON on standard output.

    It, and those of its subcommands, take whole names of options only.
    """

    as_json = False

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"allow_abbrev": False, **options})
        self._words: list[str] = []  # the command line

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        self._words = [str(word) for word in (sys.argv[1:] if args is None else args)]
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        message += self._meant(message)
        if self.as_json:
            print_json_error(message)
        super().error(message)

    def _meant(self, message: str) -> str:
        """What a word that argparse refuses may have meant."""
        if message.startswith("unrecognized arguments: "):
            word = next((w for w in message.split()[2:] if w.startswith("-")), "").partition("=")[0]
            return self._near_option(word)
        if message.startswith("the following arguments are required: "):
            given = [word.partition("=")[0] for word in self._words if word.startswith("--")]
            unknown = next((word for word in given if word not in set(_options(self, self._words))), "")
            return f" ({unknown} is unknown{near})" if (near := self._near_option(unknown)) else ""
        choice = re.search(r"invalid choice: '([^']*)' \(choose from (.*)\)$", message)
        return suggestion(choice[1], re.findall(r"[\w.:-]+", choice[2])) if choice else ""

    def _near_option(self, word: str) -> str:
        """As `suggestion`, for the hyphens that all options begin with make none alike."""
        names = {option.lstrip("-"): option for option in _options(self, self._words)}
        near = get_close_matches(word.lstrip("-"), names, n=1)
        return f"; did you mean {names[near[0]]!r}?" if near else ""


def _options(parser: argparse.ArgumentParser, words: Sequence[str]) -> Iterator[str]:
    """The options of a parser and of its subcommands; where the words name one of these, of that one alone."""
    for action in parser._actions:
        yield from action.option_strings
        if isinstance(action, argparse._SubParsersAction):
            named = [word for word in words if word in action.choices]
            for name in named[:1] or action.choices:
                yield from _options(action.choices[name], words)


class _PrintCompletion(argparse.Action):
    """Print what a shell needs to complete the command's options, and stop."""

    def __call__(self, parser: argparse.ArgumentParser, _: Any, shell: Any, __: str | None = None) -> NoReturn:
        try:
            import shtab
        except ImportError:
            parser.error('shell completion needs shtab: pip install shtab, or this package with its extra "cli"')
        for action in parser._actions:
            if action.choices is None and action.nargs != 0:  # what takes a value may take a file
                action.complete = shtab.FILE  # type: ignore[attr-defined]
        script = str(shtab.complete(parser, shell))
        # Where the options end, bash goes on with what it completes by itself: files and folders.
        print(script.replace("complete -o bashdefault -F", "complete -o default -o bashdefault -F"))
        parser.exit()


def new_parser(name: str, description: str, epilog: str = "") -> Parser:
    """A parser that keeps the lines of its texts, and knows ``--version`` and ``--print-completion``."""
    parser = Parser(
        prog=name,
        description=description,
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"{name} {__version__}")
    parser.add_argument(
        "--print-completion", action=_PrintCompletion, choices=SHELLS,
        help="print a script that completes this command's options, for the shell to read",
    )  # fmt: skip
    return parser


def add_json(parser: argparse.ArgumentParser, what: str) -> None:
    """``--json [FILE]``: see `json_target`."""
    parser.add_argument(
        "--json", nargs="?", const="-", type=json_target, metavar="FILE",
        help=f"{what}, as JSON: into a .json file, or, without FILE or with -, to standard output",
    )  # fmt: skip


def json_target(text: str) -> str:
    """An argparse type: a file that ends in .json, or ``-``.

    Any other word behind ``--json`` is likely to be an input of the command, which must not be written over.
    """
    if text != "-" and not text.lower().endswith(".json"):
        raise argparse.ArgumentTypeError(f"{text!r} is no .json file; where it is an input, put --json behind it")
    return text


def asks_for_json(words: Sequence[str]) -> bool:
    """Whether ``--json`` means standard output: alone, or with ``-``, where it comes last."""
    targets = [
        following if word == "--json" else word.removeprefix("--json=")
        for word, following in pairwise([*words, "-"])
        if word == "--json" or word.startswith("--json=")
    ]
    return bool(targets) and not targets[-1].lower().endswith(".json")


def print_json_error(text: str) -> None:
    """``{"error": text}`` on standard output; nothing where that can't be written."""
    try:
        say(json.dumps({"error": text}, indent=2))
    except OSError:
        discard_stdout()
    flush_stdout()
