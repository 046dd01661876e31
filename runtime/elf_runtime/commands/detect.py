"""elf-detect: keypoints and descriptors of images, as files and a picture."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import elf_runtime
from elf_runtime.engine import ElfRuntime
from elf_runtime.errors import ElfError, printable
from elf_runtime.image.file import ImageFile
from elf_runtime.pictures.render import detection_picture
from elf_runtime.results.features import load_record

from . import command, options
from .inputs import check_pictures, image_files
from .outputs import check_outputs, short_name, write_picture
from .terminal import say

DESCRIPTION = """\
Detect ELF keypoints in images and describe them.

For every image photos/NAME.jpg, DIR gets
  photos/NAME.npz   keypoints (N, 2) as x, y in pixels, scores (N,), descriptors (N, D), image_size (height, width),
                    nms_radius, sizes (N,), angles (N,), and a record of image, model and settings
  photos/NAME.csv   x,y,score,size,angle
  photos/NAME.png   a picture: keypoints, saliency and threshold side by side
Where a folder has NAME.png too, they are called NAME.jpg.npz and so on.
DIR mirrors the images' folders as they are given; of absolute paths what is below the folder given, or --base.
Results of another image are never overwritten.
Pixel centres are at whole numbers, (0, 0) is the centre of the top left pixel, as in OpenCV.
An image is turned as its EXIF orientation says, and so are its keypoints; --ignore-exif takes it as it is stored."""

EPILOG = """\
examples:
  elf-detect photo.jpg -o out/
  elf-detect photos/ 'more/*.png' -o out/ --max-keypoints 1000 --scale 0.5 --skip-existing
  elf-detect /data/sequence -o out/ --base /data/sequence --grid 4x6 --no-picture
  elf-detect photos/ --recursive -o out/ --ignore-exif --set normalize=0.95
  elf-detect photo.jpg -o out/ --preset paper --mask roi.png --json -

exit status: 0 if every image was done, 1 if some could not be, 2 on a wrong command line"""


def build_parser() -> command.Parser:
    parser = command.new_parser("elf-detect", DESCRIPTION, EPILOG)
    parser.add_argument("images", nargs="+", metavar="IMAGE", help="image file, folder of images, or pattern")
    parser.add_argument(
        "-r", "--recursive", action="store_true", help="of folders, take the images in their subfolders too"
    )
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        type=Path,
        metavar="DIR",
        help="folder of the results, made where it is missing; with pictures, none that images are taken from",
    )
    parser.add_argument(
        "--base", type=Path, metavar="FOLDER", help="mirror in DIR what is below this folder of the images' paths"
    )
    parser.add_argument(
        "--skip-existing", action="store_true",
        help="leave out images whose results are there, of the same pixels, model and settings",
    )  # fmt: skip
    parser.add_argument(
        "--overwrite", action="store_true", help="replace what is there even if it is not this image's result"
    )
    parser.add_argument(
        "--mask",
        metavar="FILE",
        help="image of the same size: keypoints only where it is not black, and away from its edge (see mask_border)",
    )
    parser.add_argument("--no-picture", action="store_true", help="write no NAME.png")
    parser.add_argument("--json", metavar="FILE", help="write a summary of the run; - is standard output")
    options.add_image_options(parser)
    options.add_detection_options(parser)
    options.add_model_options(parser)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    return command.run(build_parser(), _work, argv)


def _work(args: argparse.Namespace) -> int:
    stems = {path: args.output / name for path, name in image_files(args.images, args.recursive, args.base).items()}
    paths = list(stems)
    # Two images of one name: the second finds the first's results there.
    written = [Path(f"{stem}.{ending}") for stem in dict.fromkeys(stems.values()) for ending in _endings(args)]
    check_outputs(
        {"-o": written, "--json": [args.json]},
        {"an input image": paths, "the mask": [args.mask], "the model": [args.model]},
        made=args.output,
    )
    if not args.no_picture:
        check_pictures(args.images, paths, args.output, args.recursive)
    elf = options.open_runtime(args)
    run = _Run(elf, args, _read_mask(args.mask, args) if args.mask else None)
    # The summary alone goes to standard output where it is asked for there.
    progress = sys.stderr if args.json == "-" else sys.stdout
    results = []
    for path, stem in stems.items():
        try:
            result = run.detect(path, stem)
        except (ElfError, OSError) as error:
            text = str(error) if str(error).startswith(printable(f"{path}:")) else f"{path}: {error}"
            command.report("elf-detect", text)
            results.append({"image": str(path), "error": text})
            continue
        results.append(result)
        say(_line(result), progress)
    if args.json:
        images = [{k: v for k, v in result.items() if k != "fewer"} for result in results]
        command.write_json(args.json, {**options.origin(elf, args), "images": images})
    return command.FAILED if any("error" in result for result in results) else 0


def _line(result: Mapping[str, Any]) -> str:
    """What is said of an image that is done."""
    first, *others = result["files"]
    files = ", ".join([first, *(Path(file).suffix for file in others)])
    if result["skipped"]:
        return printable(f"{result['image']}: skipped, {files} are of these pixels, model and settings")
    height, width = result["size"]
    count = f"{result['keypoints']} keypoints{result['fewer']}"
    return printable(f"{result['image']}: {count}, {width}x{height}, {result['seconds']:.2f} s -> {files}")


class _Run:
    """Images with one model and one set of options."""

    def __init__(self, elf: ElfRuntime, args: argparse.Namespace, mask: Any) -> None:
        self._elf, self._args, self._mask = elf, args, mask
        self._written: dict[str, str] = {}  # results -> image
        self._params = options.params(elf, args)
        self._asked = args.max_keypoints is not None or "max_keypoints" in dict(args.set)
        origin = options.origin(elf, args)
        kept = ("model_sha256", "network", "layer", "descriptor", "settings")
        self._record = {name: origin[name] for name in kept} | {"ignore_exif": args.ignore_exif}
        if mask is not None:
            self._record["mask_sha256"] = hashlib.sha256(np.packbits(mask).tobytes()).hexdigest()

    def detect(self, path: Path, stem: Path) -> dict[str, Any]:
        """Keypoints of one image, into files.

        Raises
        ------
        ElfError
            If it can't be read, or the files there are another image's results.
        """
        start = time.perf_counter()
        files = [f"{stem}.{ending}" for ending in _endings(self._args)]
        image = ImageFile(path, self._args.max_pixels)
        record = self._record | {"image": os.path.realpath(path), "image_sha256": image.sha256}
        record["elf-onnx"] = elf_runtime.__version__
        if self._existing(record, files):
            self._written[files[0]] = record["image"]
            return {"image": str(path), "files": files, "skipped": True}
        pixels = image.decoded(self._args.ignore_exif)
        read = time.perf_counter() - start
        trace = self._elf.trace(pixels, mask=self._mask, **options.settings(self._args))
        seconds = time.perf_counter() - start
        stem.parent.mkdir(parents=True, exist_ok=True)
        # First the record of whose results these are.  What is left of earlier ones goes before it comes: an image that
        # is interrupted has files too few, never some of other settings.
        for file in files[1:]:
            Path(file).unlink(missing_ok=True)
        trace.features.save(f"{stem}.npz", record)
        self._written[files[0]] = record["image"]
        trace.features.save(f"{stem}.csv")
        if not self._args.no_picture:
            picture = detection_picture(pixels, trace, short_name(path))
            write_picture(Path(f"{stem}.png"), picture)
        return {
            "image": str(path),
            "files": files,
            "size": list(trace.features.image_size),
            "keypoints": len(trace.features),
            "fewer": self._why_fewer(len(trace.features)),
            "passed": float(trace.mask.mean()),
            "seconds": seconds,
            "stages": trace.seconds | {"read": read},
            "skipped": False,
        }

    def _why_fewer(self, count: int) -> str:
        """Why there are fewer keypoints than the user asked for; empty where there are not."""
        if not self._asked or count >= self._params.max_keypoints:
            return ""
        masked = " and the mask" if self._mask is not None else ""
        limit = "there are" if self._params.threshold == "none" else f"the threshold (--threshold){masked} let through"
        return f" of {self._params.max_keypoints} asked for: {limit} no more"

    def _existing(self, record: Mapping[str, Any], files: Sequence[str]) -> bool:
        """Whether the files are there and need not be made again."""
        if files[0] in self._written:
            raise ElfError(f"{files[0]} holds the results of {self._written[files[0]]}; give another -o, or --base")
        there = [file for file in files if os.path.lexists(file)]
        if not there:
            return False
        found = load_record(files[0])
        same = found == json.loads(json.dumps(record)) and len(there) == len(files)
        if self._args.skip_existing and same:
            return True
        if self._args.overwrite:
            return False
        if found is None or found.get("image") != record["image"]:
            whose = "is no result of elf-detect" if found is None else f"holds the results of {found.get('image')}"
            raise ElfError(f"{there[0]} {whose}; give another -o, or --base, or --overwrite")
        return False


def _endings(args: argparse.Namespace) -> list[str]:
    """Of the files that each image gets."""
    return ["npz", "csv"] if args.no_picture else ["npz", "csv", "png"]


def _read_mask(path: str, args: argparse.Namespace) -> Any:
    mask = options.read_image(path, args)
    # A colour picture of a mask: black is black in all of its colours.  What alpha leaves out counts as black.
    return mask > 0 if mask.ndim == 2 else mask[:, :, :3].any(axis=2) & (mask[:, :, 3:] > 0).all(axis=2)


if __name__ == "__main__":
    sys.exit(main())
