"""``elf-eval report``: the page of a results file, again."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from elf_eval.report.page import write_report
from elf_eval.run.results import Results
from elf_eval.suite.file import load_suite
from elf_eval.suite.suite import Suite

from .options import Subcommands, add_out
from .outputs import check_folder, say_written


def add_parser(commands: Subcommands) -> None:
    parser = commands.add_parser("report", help="tables, plots and page of a results file, again")
    parser.add_argument("results", help="results.json of elf-eval run")
    parser.add_argument("--suite", help="its title, notes, tables and rows of the paper")
    add_out(parser, "by default the folder of the results", required=False)
    parser.set_defaults(action=_report)


def with_rows(results: Results, suite: Suite) -> Results:
    """Results with what a suite says of the paper: rows of their methods, and experiments of their datasets."""
    rows = {entry.name: entry.paper for entry in suite.methods}
    about = {entry.name: {"published": entry.published, "paper": entry.paper} for entry in suite.datasets}
    return replace(
        results,
        methods=[{**m, "paper": rows.get(m["name"], m["paper"])} for m in results.methods],
        datasets=[{**d, **about.get(d["name"], {})} for d in results.datasets],
    )


def _report(args: argparse.Namespace) -> None:
    results, out = Results.load(Path(args.results)), Path(args.out or Path(args.results).parent)
    pictures = sorted((out / "pictures").glob("*.jpg"))
    suite = load_suite(Path(args.suite)) if args.suite else None
    page = (suite.title, suite.note, suite.tables) if suite else ("Evaluation", "", [])
    results = with_rows(results, suite) if suite else results
    check_folder(out)
    say_written(out, write_report(results, out, *page, args.command_line, pictures))
