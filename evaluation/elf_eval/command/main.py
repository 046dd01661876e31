"""``elf-eval``: run, report, compare, pareto, sweep, images, list."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2

from elf_eval.bench.pareto import Study, study
from elf_eval.data import DATASETS, open_dataset
from elf_eval.errors import EvalError
from elf_eval.methods import METHODS
from elf_eval.methods.opencv import OPENCV, installed
from elf_eval.protocol import Protocol
from elf_eval.report import compare as comparing
from elf_eval.report import pareto as pareto_report
from elf_eval.report import plots, write_index, write_pictures, write_report
from elf_eval.run.results import Results
from elf_eval.run.runner import run
from elf_eval.suite import sweep as sweeping
from elf_eval.suite.suite import Suite
from elf_runtime.commands.command import run as run_command
from elf_runtime.files.write import unwritable

from .arguments import build_parser
from .from_arguments import protocol, resources, suite_by_hand
from .outputs import check_folder, say_written


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status: 0 done, 1 an error that was explained, 130 interrupted, 143 ended by
    SIGTERM."""
    arguments = list(sys.argv[1:] if argv is None else argv)

    def work(args: argparse.Namespace) -> int:
        args.command_line = shlex.join(["elf-eval", *arguments])
        args.action(args)
        return 0

    return run_command(build_parser(_ACTIONS), work, arguments, goes_on="the same command goes on from here")


def _run(args: argparse.Namespace) -> None:
    out = Path(args.out)
    by_hand = args.dataset or args.detector or args.descriptor
    if bool(args.suite) == bool(by_hand):
        raise EvalError("say either suite files, or --dataset and --detector")
    if by_hand:
        suites = [(suite_by_hand(args), out)]
    else:
        loaded = [(Suite.load(path), path.stem) for path in map(Path, args.suite)]
        suites = [(replace(s, protocol=protocol(args, s.protocol)), out / name) for s, name in loaded]
    for _, folder in suites:
        check_folder(folder)
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
    print((out / "README.md").read_text())
    say_written(out, [*names, *(["pictures/"] if pictures else []), "results.json"])


def _report(args: argparse.Namespace) -> None:
    results, out = Results.load(Path(args.results)), Path(args.out or Path(args.results).parent)
    pictures = sorted((out / "pictures").glob("*.jpg"))
    suite = Suite.load(Path(args.suite)) if args.suite else None
    page = (suite.title, suite.note, suite.tables) if suite else ("Evaluation", "", [])
    rows = {entry.name: entry.paper for entry in suite.methods} if suite else {}
    results = replace(results, methods=[{**m, "paper": rows.get(m["name"], m["paper"])} for m in results.methods])
    check_folder(out)
    say_written(out, write_report(results, out, *page, args.command_line, pictures))


def _compare(args: argparse.Namespace) -> None:
    a, b = Results.load(Path(args.a)), Results.load(Path(args.b))
    if bool(args.method_a) != bool(args.method_b):
        raise EvalError("--method-a and --method-b go together")
    methods = (args.method_a, args.method_b) if args.method_a else None
    metrics = tuple(args.metrics.split(",")) if args.metrics else None
    found = comparing.compare(a, b, metrics, methods, args.unit)
    for line in comparing.warnings(a, b):
        print(f"differs: {line}")
    print(comparing.table(found))


def _pareto(args: argparse.Namespace) -> None:
    out = Path(args.out)
    data, page = out.with_name(f"{out.name}.json"), out.with_name(f"{out.name}.md")
    picture = Path(args.picture) if args.picture else out.with_name(f"{out.name}.png")
    check_folder(out.parent)
    if args.picture and (reason := unwritable(picture.parent)):
        raise EvalError(f"--picture: {reason}")
    if args.redraw:
        found = Study.load(data)
    else:
        suite, results = Suite.load(Path(args.suite)), Results.load(Path(args.results))
        found = study(suite, results, Path(args.image), args.reference, args.repeats, args.warmup, args.threads)
        out.parent.mkdir(parents=True, exist_ok=True)
        found.save(data)
    written = [data, page]
    if plots.available():
        pareto_report.draw(found, picture)
        written.append(picture)
    shown = Path(os.path.relpath(picture, page.parent)).as_posix() if picture.exists() else None
    page.write_text(pareto_report.markdown(found, shown))
    print(page.read_text())
    print(f"written: {', '.join(map(str, written))}", file=sys.stderr)


def _sweep(args: argparse.Namespace) -> None:
    texts = sweeping.trials(args.model, sweeping.parse_grid(args.grid), args.limit, args.seed)
    tune = args.tune.split(",") if args.tune else None
    found = sweeping.sweep(
        texts, args.dataset, args.metric, args.top, protocol(args, Protocol()), resources(args), tune
    )
    print(f"{len(texts)} settings; the last line is the reference of the gain")
    print(sweeping.table(found, args.metric))


def _images(args: argparse.Namespace) -> None:
    out, size = Path(args.out), protocol(args, Protocol()).size
    refs = list(open_dataset(args.dataset).images())
    check_folder(out)
    for ref in refs:
        path = (out / ref.name).with_suffix(".png")
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), ref.open(size).pixels)
    print(f"{len(refs)} images in {out}")


def _list(_: argparse.Namespace) -> None:
    here = [kind for kind in OPENCV if installed(kind)]
    missing = [kind for kind in OPENCV if kind not in here]
    print(f"datasets: {', '.join(DATASETS)}")
    print(f"methods:  {', '.join(kind for kind in METHODS if kind not in OPENCV)}, plugin:module.function")
    print(f"OpenCV {cv2.__version__}: {', '.join(here)}; not in this build: {', '.join(missing) or 'none'}")


_ACTIONS = {
    "run": _run,
    "report": _report,
    "compare": _compare,
    "pareto": _pareto,
    "sweep": _sweep,
    "images": _images,
    "list": _list,
}


if __name__ == "__main__":
    sys.exit(main())
