"""A suite from the command line: every detector, with every descriptor where there are any, on every dataset."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from elf_eval.errors import EvalError
from elf_eval.protocol import Protocol
from elf_eval.report.method_names import without_folders
from elf_eval.suite.file import load_suite
from elf_eval.suite.suite import DatasetEntry, MethodEntry, Suite

from .options import protocol


def add_by_hand(parser: argparse.ArgumentParser) -> None:
    """The options that `suites_of` reads, beside the suites' files."""
    parser.add_argument("--dataset", action="append", help="[NAME=]kind:FOLDER[?option=value&...]; may be repeated")
    parser.add_argument("--detector", action="append", help="sift, elf:FILE.onnx?preset=paper, ...; may be repeated")
    parser.add_argument("--descriptor", action="append", help="instead of the detectors' own; may be repeated")


def is_by_hand(args: argparse.Namespace) -> bool:
    """Whether the suite is on the command line and not in files.

    Raises
    ------
    EvalError
        If it is in both, or in neither.
    """
    by_hand = bool(args.dataset or args.detector or args.descriptor)
    if bool(args.suite) == by_hand:
        raise EvalError("say either suite files, or --dataset and --detector")
    return by_hand


def load(path: Path, args: argparse.Namespace) -> Suite:
    """The suite of a file, with the protocol's options."""
    suite = load_suite(path)
    return replace(suite, protocol=protocol(args, suite.protocol))


def suite_by_hand(args: argparse.Namespace) -> Suite:
    """The suite that the options of `add_by_hand` name."""
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
