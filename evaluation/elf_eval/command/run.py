"""``elf-eval run``: methods on datasets, by hand or from suites."""

from __future__ import annotations

import argparse
from pathlib import Path

from elf_eval.report.page import write_index, write_report
from elf_eval.report.pictures import write_pictures
from elf_eval.run.runner import open_datasets, run
from elf_eval.suite.suite import Suite

from .by_hand import add_by_hand, is_by_hand, load, suite_by_hand
from .options import Subcommands, add_out, add_protocol, add_resources, resources
from .outputs import check_folder, say_written


def add_parser(commands: Subcommands) -> None:
    parser = commands.add_parser("run", help="evaluate methods on datasets")
    parser.add_argument(
        "suite",
        nargs="*",
        help="TOML files: methods, datasets, protocol, tables, pictures; each into OUT/NAME",
    )
    add_by_hand(parser)
    add_out(parser, "folder of the results")
    add_protocol(parser)
    add_resources(parser)
    parser.set_defaults(action=_run)


def _run(args: argparse.Namespace) -> None:
    out = Path(args.out)
    by_hand = is_by_hand(args)
    if by_hand:
        suites = [(suite_by_hand(args), out)]
    else:
        suites = [(load(path, args), out / path.stem) for path in map(Path, args.suite)]
    for suite, folder in suites:
        check_folder(folder)
        if len(suites) > 1:  # a folder that the last one lacks is said before the first one's hours
            open_datasets(suite)
    for suite, folder in suites:
        _run_suite(suite, folder, args)
    if not by_hand:
        write_index(out)
        say_written(out, ["README.md"])


def _run_suite(suite: Suite, out: Path, args: argparse.Namespace) -> None:
    log = out / "unfinished.jsonl"
    results = run(suite, resources(args), log)  # makes the folder once there is something to keep
    results.save(out / "results.json")
    log.unlink(missing_ok=True)
    pictures = write_pictures(suite, results, out / "pictures", resources(args))
    names = write_report(results, out, suite.title, suite.note, suite.tables, args.command_line, pictures)
    print((out / "README.md").read_text(encoding="utf-8"))
    say_written(out, [*names, *(["pictures/"] if pictures else []), "results.json"])
