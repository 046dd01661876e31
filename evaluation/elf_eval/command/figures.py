"""``elf-eval figures``: the paper's figures, each by a command of its own."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from elf_eval.data import open_dataset
from elf_eval.data.images import ImageRef
from elf_eval.errors import EvalError, reason
from elf_eval.methods import open_method, open_methods
from elf_eval.methods.elf import Elf
from elf_eval.methods.gradient import Gradient
from elf_eval.protocol import Protocol
from elf_eval.report import experiments, plots, result_figures, saliency_figures, viewpoint_figure
from elf_eval.report.pictures import draw_matches
from elf_eval.run.cache import FeatureCache
from elf_eval.run.results import Results
from elf_eval.run.workers import set_threads
from elf_eval.suite.file import load_suite
from elf_runtime.pictures.canvas import stacked
from elf_runtime.pictures.file import write_picture

from .options import Subcommands, add_out, add_protocol, add_resources, protocol, resources
from .outputs import check_folder
from .report import with_rows

_OF_RESULTS = {
    "bars": (
        result_figures.bars,
        experiments.check_generic,
        "repeatability and matching score beside the paper's (figure 5)",
    ),
    "curves": (plots.curves, None, "the same over angle or scale, beside the paper's (figures 6 and 7)"),
    "viewpoint": (
        viewpoint_figure.viewpoint,
        experiments.check_viewpoint,
        "the same over the images of each of Strecha's scenes (figure 8)",
    ),
    "components": (
        result_figures.components,
        experiments.check_generic,
        "detector and descriptor apart, beside the paper's (figure 9)",
    ),
}


def add_parser(commands: Subcommands) -> None:
    parser = commands.add_parser("figures", help="the paper's figures as pictures")
    figures = parser.add_subparsers(required=True, metavar="FIGURE", help="which; each has its own --help")
    for name, (of_results, check, text) in _OF_RESULTS.items():
        figure = _figure(figures, name, text, _of_results)
        figure.add_argument("results", help="results.json of elf-eval run")
        figure.add_argument("--dataset", help="which, where there are several")
        figure.add_argument("--suite", help="whose rows of the paper stand beside the results' methods")
        figure.set_defaults(draw=of_results, check=check)
    for name, text, draw in (
        ("layers", "saliency, threshold and keypoints of each model (figures 1, 2, appendix)", _layers),
        ("gradients", "Sobel, Laplacian and each model's saliency, with keypoints", _gradients),
    ):
        figure = _figure(figures, name, text, draw)
        figure.add_argument("--image", required=True, help="photograph")
        figure.add_argument("--model", action="append", required=True, help="elf:FILE.onnx?preset=paper, ...")
        figure.add_argument("--crop", type=_crop, help="X,Y,WIDTH,HEIGHT: enlarge this part")
        add_protocol(figure)
        add_resources(figure)
    figure = _figure(figures, "matches", "matches of a pair before any geometry is fitted, method by method", _matches)
    figure.add_argument("--dataset", required=True, help="kind:FOLDER[?option=value&...]")
    figure.add_argument("--pair", required=True, help='"v_graf/1.png - v_graf/3.png"')
    figure.add_argument("--detector", action="append", required=True, help="may be repeated")
    figure.add_argument("--descriptor", help="instead of the detectors' own")
    add_protocol(figure)
    add_resources(figure)


def _figure(
    figures: Subcommands, name: str, text: str, action: Callable[[argparse.Namespace], None]
) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = figures.add_parser(name, help=text)
    add_out(parser, ".png, .jpg", metavar="FILE")
    parser.set_defaults(action=action)
    return parser


def _of_results(args: argparse.Namespace) -> None:
    if not plots.available():
        raise EvalError("matplotlib, which draws this figure, is not installed: pip install matplotlib")
    out, results = _picture(args), Results.load(Path(args.results))
    if args.suite:
        results = with_rows(results, load_suite(Path(args.suite)))
    dataset = result_figures.dataset_of(results, args.dataset)
    if args.check is not None:
        args.check(results, dataset)
    figure = args.draw(results, dataset)
    out.parent.mkdir(parents=True, exist_ok=True)
    try:
        figure.savefig(out, dpi=130, metadata={"Software": None} if out.suffix == ".png" else None)
    except (OSError, ValueError) as error:
        raise EvalError(f"{out}: {reason(error)}") from error
    print(args.out)


def _layers(args: argparse.Namespace) -> None:
    _saliency(args, args.model, saliency_figures.layers_figure)


def _gradients(args: argparse.Namespace) -> None:
    _saliency(args, ["sobel", "laplacian", *args.model], saliency_figures.gradients_figure)


def _saliency(args: argparse.Namespace, texts: list[str], draw: Callable[..., Any]) -> None:
    out, settings, path = _picture(args), protocol(args, Protocol()), Path(args.image)
    set_threads(args.threads)
    image = ImageRef(path.name, path).open(settings.size)
    methods = [_with_saliency(text, args.threads) for text in texts]
    if args.crop is not None:
        x, y, width, height = args.crop
        if x + width > image.size[0] or y + height > image.size[1]:
            raise EvalError(f"--crop reaches out of the image, which has {image.size[0]}x{image.size[1]} pixels")
    seen = [saliency_figures.seen_by(method, image, settings.max_keypoints) for method in methods]
    out.parent.mkdir(parents=True, exist_ok=True)
    write_picture(out, draw(image, seen, args.crop))
    print(args.out)


def _with_saliency(text: str, threads: int | None) -> Elf | Gradient:
    method = open_method(text, threads)
    if not isinstance(method, (Elf, Gradient)):
        raise EvalError(f"{text}: a saliency map is of elf:FILE.onnx, sobel or laplacian")
    return method


def _matches(args: argparse.Namespace) -> None:
    out, settings, pair = _picture(args), protocol(args, Protocol()), open_dataset(args.dataset).pair(args.pair)
    set_threads(args.threads)
    cache, rows = FeatureCache(resources(args).cache), []
    pixels = pair.pixels(settings.size)
    methods = [open_methods(text, args.descriptor, args.threads) for text in args.detector]
    for text, method in zip(args.detector, methods, strict=True):
        first, second = (cache.get(method, ref, settings)[1] for ref in (pair.first, pair.second))
        title, own = text.rpartition("/")[2], method.protocol(settings)
        rows.append(draw_matches(*pixels, first, second, pair, own, title))
    out.parent.mkdir(parents=True, exist_ok=True)
    write_picture(out, np.asarray(stacked(rows), np.uint8))
    print(args.out)


def _picture(args: argparse.Namespace) -> Path:
    """The picture's path, its folder checked before the work; a missing one is made when the picture is written."""
    check_folder(Path(args.out).parent)
    return Path(args.out)


def _crop(text: str) -> tuple[int, int, int, int]:
    try:
        x, y, width, height = (int(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not X,Y,WIDTH,HEIGHT") from None
    if min(x, y) < 0 or min(width, height) < 8:
        raise argparse.ArgumentTypeError(f"{text!r}: X and Y are from 0 on, WIDTH and HEIGHT 8 or more")
    return x, y, width, height
