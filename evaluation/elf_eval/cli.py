"""``elf-eval``: run, report, compare, pareto, sweep, sfm, figures, depth, images, list."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence

from elf_runtime.commands.command import run as run_command
from elf_runtime.commands.parser import Parser, new_parser

from .command import compare, depth, figures, images, kinds, pareto, report, run, sfm, sweep


def build_parser() -> Parser:
    """The parser; the function of the subcommand ends up in ``args.action``."""
    parser = new_parser("elf-eval", "Compare keypoint detectors and descriptors, by the ELF paper's protocol.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in (run, report, compare, pareto, sweep, sfm, figures, depth, images, kinds):
        command.add_parser(commands)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point.

    Returns
    -------
    int
        The exit status: 0 done, 1 an error that was explained, 130 interrupted, 143 ended by SIGTERM.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)

    def work(args: argparse.Namespace) -> int:
        args.command_line = shlex.join(["elf-eval", *arguments])
        args.action(args)
        return 0

    return run_command(build_parser(), work, arguments, goes_on="the same command goes on from here")


if __name__ == "__main__":
    sys.exit(main())
