"""The options that several subcommands share, and what they stand for."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import TypeAlias

from elf_eval.protocol import Protocol
from elf_eval.run.cache import default_folder
from elf_eval.run.runner import Resources
from elf_runtime.commands.options import positive

Subcommands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"


def add_protocol(parser: argparse.ArgumentParser, scores: bool = True) -> None:
    """The options that `protocol` reads; without `scores` none of those that are of repeatability and its like."""
    group = parser.add_argument_group("protocol")
    group.add_argument("--size", type=image_size, help="WIDTHxHEIGHT (640x480) or source")
    group.add_argument("--max-keypoints", type=positive, help="500")
    group.add_argument(
        "--ratio", type=float, help="of Lowe's test for the matches (none); a method's own, sift?ratio=0.8, goes before"
    )
    if not scores:
        return
    group.add_argument(
        "--refine", action="store_true", default=None,
        help="refine the matches by the two images (no); a method's own, sift?refine=true, goes before",
    )  # fmt: skip
    group.add_argument("--eps", type=float, help="pixels (5)")
    group.add_argument("--counts", type=lambda text: text.split(","), help="own, equal or own,equal")
    group.add_argument(
        "--count-floor", type=natural, help="equal counts are at least this; a method with fewer keeps what it has (0)"
    )


def protocol(args: argparse.Namespace, base: Protocol) -> Protocol:
    """`base`, changed by the options that were given."""
    names = ("size", "max_keypoints", "eps", "counts", "count_floor", "ratio", "refine")
    changes = {name: getattr(args, name, None) for name in names}
    return Protocol.from_dict({**vars(base), **{k: v for k, v in changes.items() if v is not None}})


def add_out(parser: argparse.ArgumentParser, text: str, metavar: str = "FOLDER", required: bool = True) -> None:
    """`args.out`: where the results go."""
    names = ("-o", "--output", "--out")
    parser.add_argument(*names, dest="out", metavar=metavar, required=required, help=text)


def add_resources(parser: argparse.ArgumentParser) -> None:
    """The options that `resources` reads."""
    group = parser.add_argument_group("resources")
    group.add_argument("--cache", default=str(default_folder()), help="folder of the features (%(default)s)")
    group.add_argument("--workers", type=positive, default=1, help="processes (1)")
    group.add_argument("--threads", type=positive, help="threads of each process (all cores)")
    group.add_argument("-q", "--quiet", action="store_true", help="no progress lines")


def resources(args: argparse.Namespace) -> Resources:
    """What the options of that group say."""
    return Resources(Path(args.cache), args.workers, args.threads, args.quiet)


def image_size(text: str) -> str | tuple[int, int]:
    """``640x480`` as (width, height); ``source`` as it is."""
    if text == "source":
        return text
    match = re.fullmatch("([1-9][0-9]*)x([1-9][0-9]*)", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT or source")
    return int(match[1]), int(match[2])


def natural(text: str) -> int:
    """A whole number from 0 on."""
    if re.fullmatch("[0-9]+", text) is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 on")
    return int(text)
