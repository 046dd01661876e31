"""elf-detect: keypoints and descriptors of images, as files and a picture."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from elf_runtime import image as images
from elf_runtime.engine import ElfRuntime
from elf_runtime.errors import ElfError
from elf_runtime.render import detection_picture

from . import _common
from ._inputs import check_pictures, image_files, output_names
from ._outputs import check_outputs

DESCRIPTION = """\
Detect ELF keypoints in images and describe them.

For every image NAME.png, DIR gets
  NAME.npz   keypoints (N, 2) as x, y in pixels, scores (N,), descriptors (N, D), image_size (height, width),
             nms_radius
  NAME.csv   x,y,score
  NAME.png   a picture: keypoints, saliency and threshold side by side
Pixel centres are at whole numbers, (0, 0) is the centre of the top left pixel, as in OpenCV.
An image is turned as its EXIF orientation says, and so are its keypoints; --ignore-exif takes it as it is stored."""

EPILOG = """\
examples:
  elf-detect photo.jpg -o out/
  elf-detect photos/ 'more/*.png' -o out/ --max-keypoints 1000 --scale 0.5
  elf-detect photos/ --recursive -o out/ --ignore-exif --set normalize=0.95
  elf-detect photo.jpg -o out/ --preset paper --mask roi.png --json -

exit status: 0 if every image was done, 1 if some could not be, 2 on a wrong command line"""


def build_parser() -> argparse.ArgumentParser:
    parser = _common.new_parser("elf-detect", DESCRIPTION, EPILOG)
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
        "--mask", metavar="FILE", help="image of the same size: keypoints only where it is not black"
    )
    parser.add_argument("--no-picture", action="store_true", help="write no NAME.png")
    parser.add_argument("--json", metavar="FILE", help="write a summary of the run; - is standard output")
    _common.add_exif_option(parser)
    _common.add_detection_options(parser)
    _common.add_model_options(parser)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    return _common.run(build_parser(), _work, argv)


def _work(args: argparse.Namespace) -> int:
    paths = image_files(args.images, args.recursive)
    names = output_names(paths)
    written = [args.output / f"{name}.{ending}" for name in names for ending in _endings(args)]
    check_outputs(
        {"-o": written, "--json": [args.json]},
        {"an input image": paths, "the mask": [args.mask], "the model": [args.model]},
        made=args.output,
    )
    if not args.no_picture:
        check_pictures(args.images, paths, args.output, args.recursive)
    elf = _common.open_runtime(args)
    mask = _read_mask(args.mask, args.ignore_exif) if args.mask else None
    # The summary alone goes to standard output where it is asked for there.
    progress = sys.stderr if args.json == "-" else sys.stdout
    results = []
    for path, name in zip(paths, names, strict=True):
        try:
            result = _detect(elf, path, args.output / name, mask, args)
        except (ElfError, OSError) as error:
            text = str(error) if str(error).startswith(f"{path}:") else f"{path}: {error}"
            _common.report("elf-detect", text)
            results.append({"image": str(path), "error": text})
            continue
        results.append(result)
        height, width = result["size"]
        print(
            f"{path}: {result['keypoints']} keypoints, {width}x{height}, {result['seconds']:.2f} s"
            f" -> {result['output']}",
            file=progress,
        )
    if args.json:
        _write_summary(args, elf, results)
    return _common.FAILED if any("error" in result for result in results) else 0


def _detect(elf: ElfRuntime, path: Path, stem: Path, mask: Any, args: argparse.Namespace) -> dict[str, Any]:
    start = time.perf_counter()
    pixels = images.read(path, ignore_exif=args.ignore_exif)
    read = time.perf_counter() - start
    trace = elf.trace(pixels, mask=mask, **_common.settings(args))
    seconds = time.perf_counter() - start
    endings = _endings(args)
    stem.parent.mkdir(parents=True, exist_ok=True)
    for ending in ("npz", "csv"):
        trace.features.save(f"{stem}.{ending}")
    if not args.no_picture:
        _common.write_picture(Path(f"{stem}.png"), detection_picture(pixels, trace, _common.short_name(path)))
    return {
        "image": str(path),
        "output": f"{stem}.{endings[0]}, " + ", ".join(f".{ending}" for ending in endings[1:]),
        "files": [f"{stem}.{ending}" for ending in endings],
        "size": list(trace.features.image_size),
        "keypoints": len(trace.features),
        "passed": float(trace.mask.mean()),
        "seconds": seconds,
        "stages": trace.seconds | {"read": read},
    }


def _endings(args: argparse.Namespace) -> list[str]:
    """Of the files that each image gets."""
    return ["npz", "csv"] if args.no_picture else ["npz", "csv", "png"]


def _read_mask(path: str, ignore_exif: bool) -> Any:
    mask = images.read(path, ignore_exif=ignore_exif)
    # A colour picture of a mask: black is black in all of its colours.  What alpha leaves out counts as black.
    return mask if mask.ndim == 2 else mask[:, :, :3].any(axis=2) & (mask[:, :, 3:] > 0).all(axis=2)


def _write_summary(args: argparse.Namespace, elf: ElfRuntime, results: list[dict[str, Any]]) -> None:
    contract = elf.contract
    spec = contract.descriptor(args.descriptor)
    summary = {
        "model": args.model or "bundled",
        "network": contract.network,
        "layer": contract.layer,
        "descriptor": spec.layer if spec else None,
        "provider": elf.providers[0],
        "settings": _common.params(elf, args).to_dict(),
        "images": [{k: v for k, v in result.items() if k != "output"} for result in results],
    }
    text = json.dumps(summary, indent=2) + "\n"
    if args.json == "-":
        sys.stdout.write(text)
    else:
        Path(args.json).parent.mkdir(parents=True, exist_ok=True)
        _common.write_text(Path(args.json), text)


if __name__ == "__main__":
    sys.exit(main())
