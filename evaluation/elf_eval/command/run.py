"""``elf-eval run``: methods on datasets, by hand or from suites."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from elf_eval.errors import EvalError
from elf_eval.protocol import Protocol
from elf_eval.report.method_names import without_folders
from elf_eval.report.page import write_index, write_report
from elf_eval.report.pictures import write_pictures
from elf_eval.run.runner import open_datasets, run
from elf_eval.suite.file import load_suite
from elf_eval.suite.suite import DatasetEntry, MethodEntry, Suite

from .options import Subcommands, add_protocol, add_resources, protocol, resources
from .outputs import check_folder, say_written


def add_parser(commands: Subcommands) -> None:
    parser = commands.add_parser("run", help="evaluate methods on datasets")
    parser.add_argument(
        "suite",
        nargs="*",
        help="TOML files: methods, datasets, protocol, tables, pictures; each into OUT/NAME",
    )
    parser.add_argument("--dataset", action="append", help="[NAME=]kind:FOLDER[?option=value&...]; may be repeated")
    parser.add_argument("--detector", action="append", help="sift, elf:FILE.onnx?preset=paper, ...; may be repeated")
    parser.add_argument("--descriptor", action="append", help="instead of the detectors' own; may be repeated")
    parser.add_argument(
        "-o", "--output", "--out", dest="out", metavar="FOLDER", required=True, help="folder of the results"
    )
    add_protocol(parser)
    add_resources(parser)
    parser.set_defaults(action=_run)


def _run(args: argparse.Namespace) -> None:
    out = Path(args.out)
    by_hand = args.dataset or args.detector or args.descriptor
    if bool(args.suite) == bool(by_hand):
        raise EvalError("say either suite files, or --dataset and --detector")
    if by_hand:
        suites = [(_suite_by_hand(args), out)]
    else:
        loaded = [(load_suite(path), path.stem) for path in map(Path, args.suite)]
        suites = [(replace(s, protocol=protocol(args, s.protocol)), out / name) for s, name in loaded]
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


def _suite_by_hand(args: argparse.Namespace) -> Suite:
    """Every detector, with every descriptor where there are any, on every dataset."""
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
    return Suite(methods, datasets, protocol=protocol(args, Protocol(counts=("own",))))


def _named(text: str) -> tuple[str, str]:
    """``NAME=kind:folder``, or ``kind:folder``, which is named by its kind."""
    name, equals, spec = text.partition("=")
    return (name, spec) if equals and ":" not in name else (text.partition(":")[0], text)
