"""elf-localize: where new images of a scene were taken, in the model that elf-reconstruct made of it."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_runtime.engine import ElfRuntime
from elf_runtime.errors import ElfError, SettingError, printable, reason
from elf_runtime.image.exif import focal_length_px
from elf_runtime.image.file import image_errors, read
from elf_runtime.params import DetectionParams
from elf_runtime.reconstruction.cameras import Camera
from elf_runtime.reconstruction.localize import Localization, localize
from elf_runtime.reconstruction.model import Model, read_model
from elf_runtime.results.features import Features

from . import command, options
from .camera_options import Given, add_calibration_options, calibration_of, check_first, read_calibration
from .inputs import image_files
from .outputs import check_outputs
from .parser import Parser, add_json, new_parser
from .reconstruct import RECORD
from .reconstruct_steps import camera_data, pose_data
from .terminal import say

DESCRIPTION = """\
Find where images were taken, in the model of the scene that elf-reconstruct made: detect keypoints with the model's
settings, match them with those of its images, and estimate the pose from the points that these show.

The pose is from world to camera, in COLMAP's convention: qvec (w, x, y, z) and tvec.  Its unit of length is the
model's.  Images are taken as they are stored, whatever their EXIF orientation says.
Without --K or --camera an image has the model's camera for images of its size, and of several the one whose images
match best; where there is none, its focal length is that of the EXIF data, or is estimated too."""

EPILOG = """\
examples:
  elf-localize out/scene new.jpg
  elf-localize out/scene new/ --json poses.json

exit status: 0 if every image was placed, 1 if some could not be, 2 on a wrong command line"""


def build_parser() -> Parser:
    parser = new_parser("elf-localize", DESCRIPTION, EPILOG)
    parser.add_argument("scene", type=Path, metavar="SCENE", help="folder that elf-reconstruct wrote")
    parser.add_argument("images", nargs="+", metavar="IMAGE", help="image file, folder of images, or pattern")
    add_json(parser, "the poses")
    options.add_quiet(parser)
    options.add_max_pixels_option(parser)
    options.add_mask(parser)
    add_calibration_options(parser.add_argument_group("camera"))
    options.add_model_options(parser)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    return command.run(build_parser(), _work, argv)


@dataclass(frozen=True, eq=False)
class _Scene:
    """What is known of the scene."""

    model: Model
    features: Mapping[str, Features]
    record: Mapping[str, Any]


def _work(args: argparse.Namespace) -> int:
    paths = list(image_files(args.images))
    check_outputs(
        {"--json": [args.json]}, {"an input image": paths, "the model": [args.model], "the mask": [args.mask]}
    )
    args.calibration = read_calibration(args)
    scene = _read_scene(args.scene)
    check_first(args.calibration, paths[0])
    elf = _open_model(args, scene.record)
    args.ignore_exif = True  # of the mask, as of the images
    mask = options.read_mask(args)
    stream = sys.stderr if args.json == "-" else None
    results: list[dict[str, Any]] = []
    for path in paths:
        try:
            found = _localized(elf, scene, path, args, mask)
        except SettingError:  # the same for all
            raise
        except (ElfError, OSError) as error:
            command.report("elf-localize", error)
            results.append({"image": str(path), "error": str(error)})
            continue
        if not args.quiet:
            say(printable(f"{path}: {_text(found)}"), stream)
        results.append({"image": str(path)} | _data(found))
    if args.json:
        command.write_json(args.json, {"scene": str(args.scene), "images": results})
    return 0 if all(result.get("localized") for result in results) else command.FAILED


def _read_scene(folder: Path) -> _Scene:
    """Model, features and record of a folder.

    Raises
    ------
    ElfError
        If it is not one that elf-reconstruct wrote.
    """
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
        settings, names = record["settings"], list(record["images"])
        DetectionParams.from_dict(settings)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ElfError(f"{folder}: not a folder that elf-reconstruct wrote: {RECORD}: {reason(error)}") from error
    model = read_model(folder / "sparse" / "0")
    features = {name: Features.load(folder / "features" / f"{name}.npz") for name in names if name in model.poses}
    return _Scene(model, features, record)


def _open_model(args: argparse.Namespace, record: Mapping[str, Any]) -> ElfRuntime:
    """The model of the scene's features, or the one given, which must be the same."""
    name = args.model or (record["model"] if record["model"] != "bundled" else None)
    elf = ElfRuntime(name, providers=options.provider(args), threads=args.threads, max_pixels=args.max_pixels)
    if elf.sha256 != record["model_sha256"]:
        raise ElfError(
            f"{args.scene}: its features are of another model ({record['model']}, SHA-256 {record['model_sha256'][:12]}"
            f"...) than {name or 'the bundled one'}; give that one by --model, or reconstruct the scene again"
        )
    return elf


def _localized(
    elf: ElfRuntime, scene: _Scene, path: Path, args: argparse.Namespace, mask: npt.NDArray[np.bool_] | None
) -> Localization | None:
    pixels = read(path, ignore_exif=True, max_pixels=args.max_pixels)
    params = DetectionParams.from_dict(scene.record["settings"])
    with image_errors(path):
        features = elf.detect(pixels, mask=mask, params=params, descriptor=scene.record["descriptor"])
    camera = _camera(scene.model, path, features.image_size, args.calibration)
    return localize(scene.model, scene.features, features, camera, ratio=scene.record["ratio"])


def _camera(model: Model, path: Path, size: tuple[int, int], given: Given | None) -> Camera | None:
    """The one given, or from EXIF data where the model has none of the image's size; None is `localize`'s default."""
    calibration = calibration_of(given, size)
    if calibration is not None:
        return Camera.calibrated(size, calibration)
    if any(camera.image_size == size for camera in model.cameras.values()):
        return None
    focal = focal_length_px(path)
    return None if focal is None else Camera.guessed(size, focal)


def _text(found: Localization | None) -> str:
    if found is None:
        return "not placed: too few of its keypoints match points of the model"
    x, y, z = found.pose.center
    return (
        f"at ({x:.4f}, {y:.4f}, {z:.4f}), {found.inliers} inliers of {found.matches} matches, median reprojection "
        f"error {found.reprojection_error:.3f} px"
    )


def _data(found: Localization | None) -> dict[str, Any]:
    if found is None:
        return {"localized": False}
    return {
        "localized": True,
        **pose_data(found.pose),
        "inliers": found.inliers,
        "matches": found.matches,
        "reprojection_error": found.reprojection_error,
        "camera": camera_data(found.camera),
    }


if __name__ == "__main__":
    sys.exit(main())
