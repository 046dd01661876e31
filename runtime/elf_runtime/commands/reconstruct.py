"""elf-reconstruct: photographs of a scene to COLMAP's database, a sparse model, and a picture of it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from elf_runtime.errors import ElfError, SettingError
from elf_runtime.files.write import existing, new_folder, real, unwritable
from elf_runtime.reconstruction.cameras import SHARES
from elf_runtime.reconstruction.library import pycolmap

from . import command, options
from .camera_options import add_calibration_options, check_first, read_calibration
from .command import UsageError
from .inputs import image_files
from .match_pairs import Choice, natural, read_list
from .outputs import check_outputs
from .parser import Parser, add_json, new_parser
from .reconstruct_steps import Steps

DESCRIPTION = """\
Make a sparse model of a scene from a folder of photographs: detect ELF keypoints, match them, verify the matches of
each pair, and have COLMAP's incremental mapper place the cameras and triangulate points.  Needs pycolmap, the extra
sfm: pip install "elf-onnx[sfm]".

OUT gets
  database.db           COLMAP's database: cameras, keypoints, matches, verified matches
  sparse/0/             the model, in COLMAP's binary files; sparse/1 ... where parts do not hang together
  features/NAME.npz     keypoints and descriptors of each image, which elf-localize needs
  reconstruction.png    points and cameras, from above and as the cameras look
  reconstruction.json   what was found, and by which model and settings
It appears when all is done, and not at all if something fails.

The folder's images and those below it are taken as they are stored, whatever their EXIF orientation says: COLMAP's
cameras are of stored pixels.  The images of a folder share a camera, unless their sizes or focal lengths differ.
Without --K or --camera its focal length starts from the EXIF data, else from 1.2 times the longer side, and is
estimated together with a coefficient of distortion."""

EPILOG = """\
examples:
  elf-reconstruct photos/ -o out/scene
  elf-reconstruct photos/ -o out/scene --K 2759.48,2764.16,1520.69,1006.81
  elf-reconstruct frames/ -o out/walk --pairs sequential:10 --share all --json -

exit status: 0 if a model was made; 1 if none could be, or an image can't be read, which is left out; 2 on a wrong
command line"""

RECORD = "reconstruction.json"
_KEYPOINTS = 2000


def build_parser() -> Parser:
    parser = new_parser("elf-reconstruct", DESCRIPTION, EPILOG)
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder of the photographs")
    parser.add_argument(
        "-o", "--output", required=True, type=Path, metavar="OUT", help="folder of the results, a new one"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an OUT that elf-reconstruct wrote")
    parser.add_argument(
        "--pairs", default="exhaustive", metavar="RULE",
        help="which images are matched: exhaustive (default), sequential:N (each with the next N by name), nearest:N "
        "(each with the N most like it), or a file of two names a line",
    )  # fmt: skip
    parser.add_argument(
        "--ratio", type=_ratio, default=0.9, metavar="R",
        help="keep matches below R x the second nearest distance; default: 0.9; none keeps all",
    )  # fmt: skip
    add_json(parser, "what is in reconstruction.json")
    options.add_quiet(parser)
    options.add_mask(parser)
    options.add_max_pixels_option(parser)
    cameras = parser.add_argument_group("cameras")
    cameras.add_argument(
        "--share", choices=SHARES, default="folder", help="which images have one camera; default: folder"
    )
    add_calibration_options(cameras)
    cameras.add_argument(
        "--refine-intrinsics", action="store_true",
        help="estimate focal length and distortion from --K or --camera on; by default these stay as they are given",
    )  # fmt: skip
    options.add_detection_options(parser)
    options.add_model_options(parser)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    return command.run(build_parser(), _work, argv)


def _ratio(text: str) -> float | None:
    if text == "none":
        return None
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is neither between 0 and 1 nor 'none'")
    return value


def _work(args: argparse.Namespace) -> int:
    names = _check_options(args)
    pycolmap()
    check_first(args.calibration, args.folder / names[0])
    elf = options.open_runtime(args)
    if elf.contract.descriptor(args.descriptor) is None:
        raise SettingError(f"{args.model}: exported with --desc none, it can't describe, and so not match")
    args.ignore_exif = True  # also of the mask
    mask = options.read_mask(args)
    run = Steps(args, sys.stderr if args.json == "-" else sys.stdout)
    found = run.features(elf, names, mask)
    if len(found) < 2:
        raise ElfError(f"{args.folder}: fewer than two of its images can be read")
    with new_folder(args.output) as part:
        summary = {**options.origin(elf, args), **run.reconstruct(found, part)}
        command.write_json(str(part / RECORD), summary)
    run.say(f"-> {args.output}")
    if args.json:
        command.write_json(args.json, summary)
    return command.FAILED if len(found) < len(names) else 0


def _check_options(args: argparse.Namespace) -> list[str]:
    """Refuse what can't be carried out, before any work; the images' names, relative to the folder."""
    if not args.folder.is_dir():
        raise UsageError(f"{args.folder}: there is no such folder")
    args.calibration = read_calibration(args)
    if args.refine_intrinsics and args.calibration is None:
        raise UsageError("--refine-intrinsics needs --K or --camera: what is not given is estimated in any case")
    args.preset = args.preset or "accurate"
    if args.max_keypoints is None and "max_keypoints" not in dict(args.set):
        args.max_keypoints = _KEYPOINTS
    inside, out = real(args.folder), real(args.output)
    if inside == out or inside in out.parents or out in inside.parents:
        raise UsageError(f"-o {args.output}: give a folder that is neither within {args.folder} nor around it")
    if reason := unwritable(existing(args.output.parent)):
        raise ElfError(f"-o: {reason}")
    if args.output.exists() and not (args.overwrite and (args.output / RECORD).is_file()):
        why = (
            f"has no {RECORD}, so elf-reconstruct did not write it"
            if args.overwrite
            else "exists; --overwrite replaces it"
        )
        raise UsageError(f"-o {args.output}: it {why}")
    check_outputs({"--json": [args.json]}, {"the model": [args.model], "the mask": [args.mask]})
    paths = sorted(image_files([str(args.folder)], recursive=True), key=natural)
    names = [path.relative_to(args.folder).as_posix() for path in paths]
    if unknown := [name for name in names if not _is_unicode(name)]:
        raise UsageError(f"{args.folder / unknown[0]}: COLMAP takes names in Unicode only; rename the file")
    choice = Choice.of(args.pairs)
    if choice.file is not None:
        read_list(choice.file, args.folder)
    if len(names) < 2:
        raise UsageError(f"{args.folder}: a reconstruction needs two images, and this folder has one")
    return names


def _is_unicode(name: str) -> bool:
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


if __name__ == "__main__":
    sys.exit(main())
