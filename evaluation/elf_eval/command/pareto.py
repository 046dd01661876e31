"""``elf-eval pareto``: time against quality."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from elf_eval.bench.measurement import Timing, measure
from elf_eval.bench.pareto import Study
from elf_eval.errors import EvalError
from elf_eval.metrics.families import check_metrics, is_share
from elf_eval.report import pareto, plots
from elf_eval.run.averages import metrics_in
from elf_eval.run.results import Results
from elf_eval.spec import comma_separated
from elf_eval.suite.file import load_suite
from elf_runtime.commands.options import positive
from elf_runtime.files.write import unwritable

from .options import Subcommands, add_out
from .outputs import check_folder


def add_parser(commands: Subcommands) -> None:
    parser = commands.add_parser(
        "pareto", help="time against quality: a table, and a picture of each metric with its front"
    )
    parser.add_argument("suite", help="TOML file: the methods to time; [groups] of scenes for a second table")
    parser.add_argument("results", help="results.json of elf-eval run with that suite: the quality")
    parser.add_argument("--image", required=True, help="photograph to time on, resized as the datasets' images are")
    add_out(parser, "FOLDER/NAME: writes NAME.json, NAME.md and NAME.png", metavar="FOLDER/NAME")
    parser.add_argument(
        "--metrics",
        type=comma_separated,
        help=f"comma-separated shares, a picture each; by default those of {','.join(pareto.METRICS)} that there are. "
        "The first is NAME.png, another NAME-h_auc-3.png",
    )
    parser.add_argument("--picture", help="another place for NAME.png, and for those named after it")
    parser.add_argument("--reference", default="SIFT", help="what the ratios of times are to (%(default)s)")
    parser.add_argument("--repeats", type=positive, default=10, help="interleaved repetitions (%(default)s)")
    parser.add_argument("--warmup", type=positive, default=2, help="rounds before (%(default)s)")
    parser.add_argument("--threads", type=positive, default=2, help="of each method (%(default)s)")
    parser.add_argument("--redraw", action="store_true", help="page and pictures from NAME.json, nothing is timed")
    parser.set_defaults(action=_pareto)


def _pareto(args: argparse.Namespace) -> None:
    out = Path(args.out)
    data, page = out.with_name(f"{out.name}.json"), out.with_name(f"{out.name}.md")
    picture = Path(args.picture) if args.picture else out.with_name(f"{out.name}.png")
    check_folder(out.parent)
    if args.picture and (reason := unwritable(picture.parent)):
        raise EvalError(f"--picture: {reason}")
    if args.redraw:
        study = Study.load(data)
        metrics = _metrics(args.metrics, study.metrics(), f"{data} has")
    else:
        timing = Timing(Path(args.image), args.reference, args.repeats, args.warmup, args.threads)
        suite, results = load_suite(Path(args.suite)), Results.load(Path(args.results))
        metrics = _metrics(args.metrics, [m for m in metrics_in(results.pairs) if is_share(m)], "these results have")
        study = measure(suite, results, timing)
        out.parent.mkdir(parents=True, exist_ok=True)
        study.save(data)
    pictures = _pictures(picture, metrics)
    if plots.available():
        for metric, path in pictures.items():
            pareto.draw(study, metric, path)
    there = {metric: path for metric, path in pictures.items() if path.exists()}
    shown = {metric: Path(os.path.relpath(path, page.parent)).as_posix() for metric, path in there.items()}
    page.write_text(pareto.markdown(study, metrics, shown), encoding="utf-8")
    print(page.read_text(encoding="utf-8"))
    written = [data, page, *(there.values() if plots.available() else ())]
    print(f"written: {', '.join(map(str, written))}", file=sys.stderr)


def _metrics(asked: Sequence[str] | None, known: Sequence[str], who: str) -> list[str]:
    """The shares to draw, each once.

    Raises
    ------
    EvalError
        If one is not `known`, or none of the usual ones is.
    """
    if asked:
        check_metrics(asked, known, who)
        return list(dict.fromkeys(asked))
    found = [metric for metric in pareto.METRICS if metric in known]
    if not found:
        raise EvalError(f"nothing to draw by: {who} {', '.join(known) or 'no shares'}, none of {pareto.METRICS}")
    return found


def _pictures(first: Path, metrics: Sequence[str]) -> dict[str, Path]:
    """Where each metric's picture lies."""
    others = {m: first.with_name(f"{first.stem}-{m.replace('@', '-')}{first.suffix}") for m in metrics[1:]}
    return {metrics[0]: first, **others}
