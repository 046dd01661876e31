"""``elf-eval compare``: two results, or two methods."""

from __future__ import annotations

import argparse
from pathlib import Path

from elf_eval.errors import EvalError
from elf_eval.report.comparison import METRICS, compare, comparison_table, warnings
from elf_eval.run.results import Results

from .options import Subcommands


def add_parser(commands: Subcommands) -> None:
    parser = commands.add_parser("compare", help="what changed between two results, and whether it is noise")
    parser.add_argument("a", help="results.json of the first run")
    parser.add_argument("b", help="results.json of the second, from which the first's values are taken away")
    parser.add_argument("--method-a", help="hold this method of the first against --method-b of the second")
    parser.add_argument("--method-b", help="the other method, with --method-a")
    parser.add_argument("--metrics", help=f"comma-separated; by default {','.join(METRICS)}")
    parser.add_argument(
        "--unit", choices=("scene", "pair"), default="scene", help="what the interval is over (%(default)s)"
    )
    parser.set_defaults(action=_compare)


def _compare(args: argparse.Namespace) -> None:
    a, b = Results.load(Path(args.a)), Results.load(Path(args.b))
    if bool(args.method_a) != bool(args.method_b):
        raise EvalError("--method-a and --method-b go together")
    methods = (args.method_a, args.method_b) if args.method_a else None
    metrics = tuple(args.metrics.split(",")) if args.metrics else None
    found = compare(a, b, metrics, methods, args.unit)
    for line in warnings(a, b):
        print(f"differs: {line}")
    print(comparison_table(found))
