"""The command line's grammar."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Mapping

from elf_eval.report.compare import METRICS
from elf_eval.run.cache import default_folder
from elf_runtime.commands.command import Parser, new_parser


def build_parser(actions: Mapping[str, Callable[[argparse.Namespace], None]]) -> Parser:
    """The parser; each command's function comes from `actions` and ends up in ``args.action``."""
    parser = new_parser("elf-eval", "Compare keypoint detectors and descriptors, by the ELF paper's protocol.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    one = commands.add_parser("run", help="evaluate methods on datasets")
    one.add_argument(
        "suite",
        nargs="*",
        help="TOML files: methods, datasets, protocol, tables, pictures; each into OUT/NAME",
    )
    one.add_argument("--dataset", action="append", help="[NAME=]kind:FOLDER[?option=value&...]; may be repeated")
    one.add_argument("--detector", action="append", help="sift, elf:FILE.onnx?preset=paper, ...; may be repeated")
    one.add_argument("--descriptor", action="append", help="instead of the detectors' own; may be repeated")
    one.add_argument("--out", required=True, help="folder of the results")
    _add_protocol(one)
    _add_resources(one)
    one.set_defaults(action=actions["run"])

    one = commands.add_parser("report", help="tables, plots and page of a results file, again")
    one.add_argument("results", help="results.json of elf-eval run")
    one.add_argument("--suite", help="its title, notes, tables and rows of the paper")
    one.add_argument("--out", help="by default the folder of the results")
    one.set_defaults(action=actions["report"])

    one = commands.add_parser("compare", help="what changed between two results, and whether it is noise")
    one.add_argument("a", help="results.json of the first run")
    one.add_argument("b", help="results.json of the second, from which the first's values are taken away")
    one.add_argument("--method-a", help="hold this method of the first against --method-b of the second")
    one.add_argument("--method-b", help="the other method, with --method-a")
    one.add_argument("--metrics", help=f"comma-separated; by default {','.join(METRICS)}")
    one.add_argument(
        "--unit", choices=("scene", "pair"), default="scene", help="what the interval is over (%(default)s)"
    )
    one.set_defaults(action=actions["compare"])

    one = commands.add_parser("pareto", help="time against matching score: a table and a picture with the front")
    one.add_argument("suite", help="TOML file: the methods to time; [groups] of scenes for a second table")
    one.add_argument("results", help="results.json of elf-eval run with that suite: the quality")
    one.add_argument("--image", required=True, help="photograph to time on, resized as the datasets' images are")
    one.add_argument("--out", required=True, help="FOLDER/NAME: writes NAME.json, NAME.md and NAME.png")
    one.add_argument("--picture", help="another place for the picture")
    one.add_argument("--reference", default="SIFT", help="what the ratios of times are to (%(default)s)")
    one.add_argument("--repeats", type=_positive, default=10, help="interleaved repetitions (%(default)s)")
    one.add_argument("--warmup", type=_positive, default=2, help="rounds before (%(default)s)")
    one.add_argument("--threads", type=_positive, default=2, help="of each method (%(default)s)")
    one.add_argument("--redraw", action="store_true", help="page and picture from NAME.json, nothing is timed")
    one.set_defaults(action=actions["pareto"])

    one = commands.add_parser("sweep", help="choose settings on some scenes, report on the others")
    one.add_argument("--model", action="append", required=True, help="elf:FILE.onnx[?...]; one for each layer to try")
    one.add_argument(
        "--grid",
        action="append",
        default=[],
        help="SETTING=VALUE/VALUE/..., e.g. denoise=5,5/5,2; ranges are FROM..TO[..STEP]: denoise=3..21..2,4..13",
    )
    one.add_argument("--dataset", required=True, help="kind:FOLDER[?option=value&...]")
    one.add_argument("--tune", help="comma-separated scenes to choose on; by default every second one")
    one.add_argument("--metric", default="ms", help="what to choose by (%(default)s)")
    one.add_argument("--top", type=_positive, default=5, help="report so many (%(default)s)")
    one.add_argument("--limit", type=_positive, help="try only so many settings, drawn at random")
    one.add_argument("--seed", type=_count, default=0, help="of the draw (%(default)s)")
    _add_protocol(one)
    _add_resources(one)
    one.set_defaults(action=actions["sweep"])

    one = commands.add_parser("images", help="write a dataset's images as evaluated, for another program's features")
    one.add_argument("dataset", help="kind:FOLDER[?option=value&...]")
    one.add_argument("--out", required=True, help="folder of the images; each gets its name in the dataset, as .png")
    one.add_argument("--size", type=_size, help="WIDTHxHEIGHT or source")
    one.set_defaults(action=actions["images"])

    one = commands.add_parser("list", help="kinds of datasets and methods")
    one.set_defaults(action=actions["list"])
    return parser


def _add_protocol(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("protocol")
    group.add_argument("--size", type=_size, help="WIDTHxHEIGHT (640x480) or source")
    group.add_argument("--max-keypoints", type=_positive, help="500")
    group.add_argument("--eps", type=float, help="pixels (5)")
    group.add_argument("--counts", type=lambda text: text.split(","), help="own, equal or own,equal")
    group.add_argument(
        "--count-floor", type=_count, help="equal counts are at least this; a method with fewer keeps what it has (0)"
    )


def _add_resources(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("resources")
    group.add_argument("--cache", default=str(default_folder()), help="folder of the features (%(default)s)")
    group.add_argument("--workers", type=_positive, default=1, help="processes (1)")
    group.add_argument("--threads", type=_positive, help="threads of each process (all cores)")
    group.add_argument("--quiet", action="store_true", help="no progress lines")


def _size(text: str) -> str | tuple[int, int]:
    if text == "source":
        return text
    match = re.fullmatch("([1-9][0-9]*)x([1-9][0-9]*)", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT or source")
    return int(match[1]), int(match[2])


def _count(text: str) -> int:
    if re.fullmatch("[0-9]+", text) is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 on")
    return int(text)


def _positive(text: str) -> int:
    if re.fullmatch("0*[1-9][0-9]*", text) is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 on")
    return int(text)
