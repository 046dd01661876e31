"""elf-match: the matches of two images, or of many pairs, as counts, files and pictures."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2

from elf_runtime.errors import ElfError
from elf_runtime.files.write import existing, real, unwritable
from elf_runtime.geometry.two_view import KINDS

from . import command, options
from .command import UsageError
from .match_cameras import parse_camera
from .match_pairs import Choice, Plan, plan
from .match_run import Run
from .match_views import Views
from .outputs import check_outputs
from .parser import Parser, add_json, new_parser

DESCRIPTION = """\
Match the ELF keypoints of two images, of one image and a folder's, or of a folder's among themselves (mutual nearest
neighbours in descriptor space), count the matches, and draw or save them where that is asked for.

A and B are images, or the .npz files that elf-detect writes. Each is detected or read once. Where features take more
than 1 GiB of memory, the rest of them is kept in a temporary folder.

With --ransac, one geometry is fitted to the matches by MAGSAC++: a homography (a plane, or a camera that only turns), a
fundamental matrix (any rigid scene), or an essential matrix (one seen by known cameras), which gives the relative pose.
Its inliers are drawn in green, the other matches in thin red. One that as many unrelated matches would give by chance
is not supported by them: it is said so, and none is given.
Images are turned as their EXIF orientation says, and so are their keypoints; --ignore-exif takes them as stored."""

EPILOG = """\
examples:
  elf-match left.jpg right.jpg -o matches.png
  elf-match left.jpg right.jpg --json -
  elf-match left.jpg right.jpg -o matches.png --ratio 0.9 --ransac homography --save matches.npz
  elf-match left.jpg right.jpg --ratio 0.9 --ransac essential --K 1520,1520,959.5,539.5 --json pose.json
  elf-match query.jpg photos/ --pairs nearest:5 --json -
  elf-match photos/ --pairs nearest:20 --ratio 0.9 --ransac fundamental --save out/matches --json out/matches.json
  elf-match features/ --pairs pairs.txt --save out/matches

exit status: 0 if every pair was matched, also where no geometry is supported; 1 if an image or a file can't be read or
written, or some of many pairs could not be matched; 2 on a wrong command line

--save writes pairs (M, 2) of indices, the matched points_a and points_b (M, 2) as x, y in pixels (those of B as
--refine moved them), their scores, sizes and angles as detected (scores_a, scores_b ..., (M,)), inliers (M,), and the
fitted matrix (3, 3), NaN where there is none; with --ransac essential also rotation (3, 3) and translation (3,),
X_b = rotation X_a + translation with a translation of unit length, and the cameras K_a and K_b (3, 3).
Of a folder's pairs the files are named A--B.npz and A--B.png, by the images' names in the folder, in which / is %2F
(% is %25, and the second of two hyphens %2D)."""


def build_parser() -> Parser:
    parser = new_parser("elf-match", DESCRIPTION, EPILOG)
    parser.add_argument("a", metavar="A", help="first image, or a folder whose images are matched among themselves")
    parser.add_argument("b", metavar="B", nargs="?", help="second image, or a folder whose images A is matched with")
    parser.add_argument(
        "--pairs", metavar="WHICH",
        help="of a folder: exhaustive (default), sequential[:N] (each with the N that follow by name; 1), nearest:N "
        "(each with the N most like it by a descriptor of the whole image), or a file of two names a line",
    )  # fmt: skip
    parser.add_argument("-r", "--recursive", action="store_true", help="take the images in a folder's subfolders too")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="draw the matches: .png or .jpg; of a folder's pairs a folder"
    )
    parser.add_argument("--ratio", type=float, metavar="R", help="keep matches below R x the second nearest distance")
    parser.add_argument(
        "--refine", action="store_true",
        help="move the matched points of B to where the two images look most alike, before --ransac and in all files",
    )  # fmt: skip
    parser.add_argument("--ransac", choices=KINDS, help="fit a geometry and draw its inliers")
    parser.add_argument(
        "--ransac-threshold", type=float, metavar="PX",
        help="largest distance of an inlier, in pixels; default: 3, of an essential matrix 1",
    )  # fmt: skip
    parser.add_argument(
        "--K", metavar="CAMERA",
        help="of --ransac essential: fx,fy,cx,cy in pixels, one focal length, or a file of these or of a 3x3 matrix; "
        "default: the focal length in EXIF. Pixel centres are at whole numbers; without cx,cy the middle is taken",
    )  # fmt: skip
    parser.add_argument("--K-b", metavar="CAMERA", help="the camera of B, or of B's images, if it is not A's")
    parser.add_argument(
        "--save", type=Path, metavar="FILE", help="write the matches as .npz; of a folder's pairs a folder"
    )
    add_json(parser, "images, model, settings, counts and geometry")
    options.add_quiet(parser)
    options.add_mask(parser)
    options.add_image_options(parser)
    options.add_detection_options(parser)
    options.add_model_options(parser)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    return command.run(build_parser(), _work, argv)


def _work(args: argparse.Namespace) -> int:
    _check_options(args)
    wanted = plan(args.a, args.b, None if args.pairs is None else Choice.of(args.pairs), args.recursive)
    _check_files(args, wanted)
    with Views(wanted.paths, args) as views:
        run = Run(args, wanted, views)
        return run.single() if wanted.single else run.many()


def _check_options(args: argparse.Namespace) -> None:
    """Refuse what can't be carried out, before any work; the threshold gets its default, cameras are read."""
    if args.ransac_threshold is not None and not args.ransac:
        raise UsageError("--ransac-threshold needs --ransac homography, fundamental or essential")
    if args.ransac_threshold is None:
        args.ransac_threshold = 1.0 if args.ransac == "essential" else 3.0
    if not 0.0 < args.ransac_threshold < float("inf"):
        raise UsageError(f"--ransac-threshold {args.ransac_threshold:g}: a distance in pixels is above 0")
    if args.ratio is not None and not 0.0 < args.ratio < 1.0:
        raise UsageError(f"--ratio {args.ratio:g}: a ratio lies between 0 and 1")
    if args.K is not None and args.ransac != "essential":
        raise UsageError("--K goes with --ransac essential")
    if args.K_b is not None and (args.K is None or args.b is None):
        raise UsageError("--K-b is a second camera beside that of --K, and goes with A and B")
    args.K = None if args.K is None else parse_camera("--K", args.K)
    args.K_b = args.K if args.K_b is None else parse_camera("--K-b", args.K_b)


def _check_files(args: argparse.Namespace, wanted: Plan) -> None:
    """Refuse outputs that can't be written, or would be taken for inputs."""
    inputs = {
        "an input image": wanted.paths,
        "the model": [args.model],
        "the mask": [args.mask],
        "the list of pairs": [args.pairs],
    }
    folders = {"-o": args.output, "--save": args.save}
    if wanted.single:
        if args.save and args.save.suffix != ".npz":
            raise UsageError(f"--save {args.save}: matches are saved as .npz")
        if args.output and not cv2.haveImageWriter(f"x{args.output.suffix}"):
            raise UsageError(f"-o {args.output}: no image format has this ending; use .png or .jpg")
        check_outputs({"-o": [args.output], "--save": [args.save], "--json": [args.json]}, inputs)
        return
    source = real(args.a if args.b is None else args.b)
    for option, folder in folders.items():
        if folder is None:
            continue
        if folder.suffix in (".npz", ".png", ".jpg", ".jpeg"):
            raise UsageError(f"{option} {folder}: of many pairs it is a folder")
        if real(folder) == source or (args.recursive and source in real(folder).parents):
            raise UsageError(f"{option} {folder}: its files would be taken for images next time; give another folder")
        if reason := unwritable(existing(folder)):
            raise ElfError(f"{option}: {reason}")
    check_outputs({"--json": [args.json]}, inputs, made=args.save or args.output)


if __name__ == "__main__":
    sys.exit(main())
