"""elf-match: the matches of two images, as a picture, a file, or counts."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from elf_runtime.engine import ElfRuntime
from elf_runtime.errors import SettingError, printable
from elf_runtime.files.write import write_atomically
from elf_runtime.geometry.fit import Search, fit
from elf_runtime.geometry.two_view import TwoView
from elf_runtime.image.file import image_errors
from elf_runtime.pictures.file import short_name, write_picture
from elf_runtime.pictures.render import match_picture
from elf_runtime.results.features import Features
from elf_runtime.results.matching import match

from . import command, options
from .command import UsageError
from .outputs import check_outputs
from .parser import Parser, add_json, new_parser
from .terminal import say

DESCRIPTION = """\
Match the ELF keypoints of two images (mutual nearest neighbours in descriptor space), count the matches, and draw
or save them where that is asked for.

With --ransac, one homography (a plane, or a camera that only turns) or fundamental matrix (any rigid scene)
is fitted to them by MAGSAC++; its inliers are drawn in green, the other matches in thin red. One that as many
unrelated matches would give by chance is not supported by them: it is said so, and none is given.
Images are turned as their EXIF orientation says, and so are their keypoints; --ignore-exif takes them as stored."""

EPILOG = """\
examples:
  elf-match left.jpg right.jpg -o matches.png
  elf-match left.jpg right.jpg --json -
  elf-match left.jpg right.jpg -o matches.png --ratio 0.9 --ransac homography --save matches.npz

exit status: 0, also where no geometry is supported; 1 if an image or a file can't be read or written; 2 on a wrong
command line

--save writes pairs (M, 2) of indices, the matched points_a and points_b (M, 2) as x, y in pixels, their
scores, sizes and angles (scores_a, scores_b ..., (M,)), inliers (M,), and the fitted matrix (3, 3), NaN where there
is none."""


def build_parser() -> Parser:
    parser = new_parser("elf-match", DESCRIPTION, EPILOG)
    parser.add_argument("a", metavar="A", help="first image")
    parser.add_argument("b", metavar="B", help="second image")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="draw the matches: .png or .jpg")
    parser.add_argument("--ratio", type=float, metavar="R", help="keep matches below R x the second nearest distance")
    parser.add_argument("--ransac", choices=["homography", "fundamental"], help="fit a geometry and draw its inliers")
    parser.add_argument(
        "--ransac-threshold",
        type=float,
        metavar="PX",
        help="largest distance of an inlier, in pixels; default: 3",
    )
    parser.add_argument("--save", type=Path, metavar="FILE", help="write the matches as .npz")
    add_json(parser, "images, model, settings, counts and the matrix")
    options.add_image_options(parser)
    options.add_detection_options(parser)
    options.add_model_options(parser)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    return command.run(build_parser(), _work, argv)


def _check_options(args: argparse.Namespace) -> None:
    """Refuse what can't be carried out, before any work; the threshold gets its default."""
    if args.ransac_threshold is not None and not args.ransac:
        raise UsageError("--ransac-threshold needs --ransac homography or --ransac fundamental")
    if args.ransac_threshold is None:
        args.ransac_threshold = 3.0
    if not 0.0 < args.ransac_threshold < float("inf"):
        raise UsageError(f"--ransac-threshold {args.ransac_threshold:g}: a distance in pixels is above 0")
    if args.save and args.save.suffix != ".npz":
        raise UsageError(f"--save {args.save}: matches are saved as .npz")
    if args.ratio is not None and not 0.0 < args.ratio < 1.0:
        raise UsageError(f"--ratio {args.ratio:g}: a ratio lies between 0 and 1")
    if args.output and not cv2.haveImageWriter(f"x{args.output.suffix}"):
        raise UsageError(f"-o {args.output}: no image format has this ending; use .png or .jpg")
    check_outputs(
        {"-o": [args.output], "--save": [args.save], "--json": [args.json]},
        {"an input image": [args.a, args.b], "the model": [args.model]},
    )


def _work(args: argparse.Namespace) -> int:
    _check_options(args)
    elf = options.open_runtime(args)
    if elf.contract.descriptor(args.descriptor) is None:
        raise SettingError(f"{args.model}: exported with --desc none, it can't describe, and so not match")
    pixels = [options.read_image(path, args) for path in (args.a, args.b)]
    first, second = (_detected(elf, *image, args) for image in zip((args.a, args.b), pixels, strict=True))
    pairs = match(first, second, args.ratio)
    points = (first.keypoints[pairs[:, 0]], second.keypoints[pairs[:, 1]])
    view = fit(*points, args.ransac, Search("magsac", args.ransac_threshold)) if args.ransac else None

    text, at_best = f"{len(pairs)} matches", ""
    if view is not None:
        text += f", {int(view.inliers.sum())} {view.kind} inliers" if view.supported else f", no {view.kind}"
        if view.matrix is not None and not view.supported:
            at_best = f" that they support: {int(view.inliers.sum())} inliers at best, as chance would give"
    if args.output:
        titles = [
            (short_name(args.a), f"{len(first)} keypoints, {text}"),
            (short_name(args.b), f"{len(second)} keypoints"),
        ]
        inliers = view.inliers & view.supported if view is not None else None
        write_picture(args.output, match_picture(pixels, points, inliers, titles))
    if args.save:
        _save(args.save, pairs, (first, second), view)
    written = ", ".join(str(path) for path in (args.output, args.save) if path)
    line = f"{args.a}: {len(first)} keypoints, {args.b}: {len(second)} keypoints, {text}{at_best}"
    line = printable(line + (f" -> {written}" if written else ""))
    say(line, sys.stderr if args.json == "-" else None)
    if args.json:
        command.write_json(args.json, _summary(args, elf, (first, second), len(pairs), view))
    return 0


def _detected(elf: ElfRuntime, path: str, pixels: np.ndarray, args: argparse.Namespace) -> Features:
    """An image's features; what is wrong with it is said with its path."""
    with image_errors(path):
        return elf.detect(pixels, **options.settings(args))


def _save(path: Path, pairs: np.ndarray, found: tuple[Features, Features], view: TwoView | None) -> None:
    first, second = found
    fitted = view is not None and view.supported
    arrays = {
        "pairs": pairs,
        "points_a": first.keypoints[pairs[:, 0]],
        "points_b": second.keypoints[pairs[:, 1]],
        **{f"{name}_a": getattr(first, name)[pairs[:, 0]] for name in ("scores", "sizes", "angles")},
        **{f"{name}_b": getattr(second, name)[pairs[:, 1]] for name in ("scores", "sizes", "angles")},
        "inliers": view.inliers & view.supported if view is not None else np.ones(len(pairs), np.bool_),
        "matrix": view.matrix if view is not None and fitted else np.full((3, 3), np.nan),
    }
    write_atomically(path, lambda temporary: np.savez_compressed(temporary, **arrays))


def _summary(
    args: argparse.Namespace, elf: ElfRuntime, found: tuple[Features, Features], matches: int, view: TwoView | None
) -> dict[str, Any]:
    return {
        "images": [args.a, args.b],
        **options.origin(elf, args),
        "keypoints": [len(features) for features in found],
        "ratio": args.ratio,
        "matches": matches,
        "ransac": view.kind if view is not None else None,
        "supported": view.supported if view is not None else None,
        "inliers": int(view.inliers.sum()) if view is not None else None,
        "expected_by_chance": view.chance if view is not None and view.matrix is not None else None,
        "matrix": view.matrix.tolist() if view is not None and view.matrix is not None and view.supported else None,
    }


if __name__ == "__main__":
    sys.exit(main())
