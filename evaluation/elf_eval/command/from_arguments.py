"""What the command line says, as the objects that a run takes."""

from __future__ import annotations

import argparse
from pathlib import Path

from elf_eval.protocol import Protocol
from elf_eval.report.names import without_folders
from elf_eval.run.runner import Resources
from elf_eval.suite.suite import DatasetEntry, MethodEntry, Suite


def suite_by_hand(args: argparse.Namespace) -> Suite:
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
    """``NAME=kind:folder`` or ``kind:folder``, which is named by its kind."""
    name, equals, spec = text.partition("=")
    return (name, spec) if equals and ":" not in name else (text.partition(":")[0], text)


def protocol(args: argparse.Namespace, base: Protocol) -> Protocol:
    """`base`, changed by the options that were given."""
    changes = {name: getattr(args, name, None) for name in ("size", "max_keypoints", "eps", "counts", "count_floor")}
    return Protocol.from_dict({**vars(base), **{k: v for k, v in changes.items() if v is not None}})


def resources(args: argparse.Namespace) -> Resources:
    """The options of the group of that name."""
    return Resources(Path(args.cache), args.workers, args.threads, args.quiet)
