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

from elf_runtime import ElfError
from elf_runtime.files import discard_stdout

from . import compare as comparing
from . import sweep as sweeping
from .arguments import build_parser
from .datasets import DATASETS, open_dataset
from .errors import EvalError
from .methods import METHODS
from .methods.opencv import OPENCV, installed
from .pareto import Study, study
from .protocol import Protocol
from .report import pareto as pareto_report
from .report import plots, write_index, write_pictures, write_report
from .report.names import without_folders
from .results import Results
from .runner import Resources, run
from .suite import DatasetEntry, MethodEntry, Suite


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status: 0 done, 1 an error that was explained, 130 interrupted."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    args = build_parser(_ACTIONS).parse_args(arguments)
    args.command_line = shlex.join(["elf-eval", *arguments])
    try:
        args.action(args)
        sys.stdout.flush()
    except BrokenPipeError:
        discard_stdout()
        return 1
    except (EvalError, ElfError, OSError) as error:
        print(f"elf-eval: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nelf-eval: interrupted; the same command goes on from here", file=sys.stderr)
        return 130
    return 0


def _run(args: argparse.Namespace) -> None:
    out = Path(args.out)
    by_hand = args.dataset or args.detector or args.descriptor
    if bool(args.suite) == bool(by_hand):
        raise EvalError("say either suite files, or --dataset and --detector")
    if by_hand:
        _run_suite(_suite_by_hand(args), out, args)
    suites = [(Path(path), Suite.load(Path(path))) for path in args.suite]
    for path, suite in suites:
        protocol = _protocol(args, suite.protocol)
        _run_suite(replace(suite, protocol=protocol), out / path.stem, args)
    if suites:
        write_index(out)


def _run_suite(suite: Suite, out: Path, args: argparse.Namespace) -> None:
    out.mkdir(parents=True, exist_ok=True)
    log = out / "unfinished.jsonl"
    results = run(suite, _resources(args), log)
    results.save(out / "results.json")
    log.unlink(missing_ok=True)
    pictures = write_pictures(suite, results, out / "pictures", _resources(args))
    write_report(results, out, suite.title, suite.note, suite.tables, args.command_line, pictures)
    print((out / "README.md").read_text())
    print(f"written: {out}/README.md, index.html, tables.csv, results.json", file=sys.stderr)


def _report(args: argparse.Namespace) -> None:
    results, out = Results.load(Path(args.results)), Path(args.out or Path(args.results).parent)
    pictures = sorted((out / "pictures").glob("*.jpg"))
    if args.suite:
        suite = Suite.load(Path(args.suite))
        write_report(results, out, suite.title, suite.note, suite.tables, args.command_line, pictures)
    else:
        write_report(results, out, "Evaluation", "", [], args.command_line, pictures)
    print(f"written: {out}/README.md, index.html, tables.csv", file=sys.stderr)


def _compare(args: argparse.Namespace) -> None:
    a, b = Results.load(Path(args.a)), Results.load(Path(args.b))
    if bool(args.method_a) != bool(args.method_b):
        raise EvalError("--method-a and --method-b go together")
    methods = (args.method_a, args.method_b) if args.method_a else None
    metrics = tuple(args.metrics.split(",")) if args.metrics else comparing.METRICS
    for line in comparing.warnings(a, b):
        print(f"differs: {line}")
    print(comparing.table(comparing.compare(a, b, metrics, methods, args.unit)))


def _pareto(args: argparse.Namespace) -> None:
    out = Path(args.out)
    data, page = out.with_name(f"{out.name}.json"), out.with_name(f"{out.name}.md")
    picture = Path(args.picture) if args.picture else out.with_name(f"{out.name}.png")
    if args.redraw:
        found = Study.load(data)
    else:
        suite, results = Suite.load(Path(args.suite)), Results.load(Path(args.results))
        found = study(
            suite, results, Path(args.image), args.reference, args.repeats, args.warmup, args.threads
        )
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
        texts, args.dataset, args.metric, args.top, _protocol(args, Protocol()), _resources(args), tune
    )
    print(f"{len(texts)} settings; the last line is the reference of the gain")
    print(sweeping.table(found, args.metric))


def _images(args: argparse.Namespace) -> None:
    out, size = Path(args.out), _protocol(args, Protocol()).size
    refs = list(open_dataset(args.dataset).images())
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


def _suite_by_hand(args: argparse.Namespace) -> Suite:
    detectors, descriptors = args.detector or [], args.descriptor or []
    names = dict(zip(texts := [*detectors, *descriptors], without_folders(texts), strict=True))
    methods = [
        MethodEntry(
            f"{names[detector]} + {names[descriptor]}" if descriptor else names[detector],
            detector,
            descriptor,
        )
        for detector in detectors
        for descriptor in descriptors or [None]
    ]
    datasets = [DatasetEntry(*_named(text)) for text in args.dataset or []]
    return Suite(methods, datasets, protocol=_protocol(args, Protocol(counts=("own",))))


def _named(text: str) -> tuple[str, str]:
    """``NAME=kind:folder`` or ``kind:folder``, which is named by its kind."""
    name, equals, spec = text.partition("=")
    return (name, spec) if equals and ":" not in name else (text.partition(":")[0], text)


def _protocol(args: argparse.Namespace, base: Protocol) -> Protocol:
    changes = {name: getattr(args, name, None) for name in ("size", "max_keypoints", "eps", "counts")}
    return Protocol.from_dict({**vars(base), **{k: v for k, v in changes.items() if v is not None}})


def _resources(args: argparse.Namespace) -> Resources:
    return Resources(Path(args.cache), args.workers, args.threads, args.quiet)


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
