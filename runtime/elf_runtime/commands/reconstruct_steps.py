"""The steps of elf-reconstruct: features, matches, cameras, the database, the model, and what is said of each."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import numpy.typing as npt

from elf_runtime.engine import ElfRuntime
from elf_runtime.errors import ElfError, SettingError, printable
from elf_runtime.files.write import real
from elf_runtime.image.exif import focal_length_px
from elf_runtime.image.file import image_errors, read
from elf_runtime.pictures.file import write_picture
from elf_runtime.pictures.scene import scene_picture
from elf_runtime.reconstruction.cameras import Camera, doubts, shared_cameras
from elf_runtime.reconstruction.database import write_database
from elf_runtime.reconstruction.mapping import map_database
from elf_runtime.reconstruction.model import Model, Pose
from elf_runtime.reconstruction.pairs import Pair, exhaustive, sequential
from elf_runtime.results.features import Features
from elf_runtime.results.global_descriptor import global_descriptor, nearest_pairs
from elf_runtime.results.matches import Matches

from . import command, options
from .camera_options import calibration_of
from .match_pairs import Choice, read_list
from .terminal import say

_PATIENCE = 5.0  # seconds of work without a line
_MOST_CAMERAS = 10  # that are named one by one


class Steps:
    """One run, by the options of `elf-reconstruct`; what it finds goes into a folder that is given."""

    def __init__(self, args: argparse.Namespace, stream: TextIO) -> None:
        self._args, self._stream = args, stream
        self._spoke = time.monotonic()

    def say(self, text: str) -> None:
        if self._args.quiet:
            return
        say(printable(text), self._stream)
        self._stream.flush()
        self._spoke = time.monotonic()

    def _say_now_and_then(self, text: str) -> None:
        if time.monotonic() - self._spoke > _PATIENCE:
            self.say(text)

    def features(
        self, elf: ElfRuntime, names: Sequence[str], mask: npt.NDArray[np.bool_] | None = None
    ) -> dict[str, Features]:
        """Of each image that can be read, in pixels as stored, as is the mask; what is wrong with another is said."""
        found = {}
        for name in names:
            path = self._args.folder / name
            start = time.perf_counter()
            try:
                pixels = read(path, ignore_exif=True, max_pixels=self._args.max_pixels)
                with image_errors(path):
                    found[name] = elf.detect(pixels, mask=mask, **options.settings(self._args))
            except SettingError:  # the same for all
                raise
            except ElfError as error:
                command.report("elf-reconstruct", error)
                continue
            height, width = found[name].image_size
            seconds = time.perf_counter() - start
            self.say(f"{path}: {len(found[name])} keypoints, {width}x{height}, {seconds:.2f} s")
        return found

    def reconstruct(self, found: Mapping[str, Features], out: Path) -> dict[str, Any]:
        """From features to a model; the summary, as plain data."""
        for name, features in found.items():
            path = out / "features" / f"{name}.npz"
            path.parent.mkdir(parents=True, exist_ok=True)
            features.save(path)
        cameras = self._cameras(found)
        matches = self._matches(found)
        verified = write_database(
            out / "database.db", found, matches, cameras,
            lambda done, of: self._say_now_and_then(f"verified {done} of {of} pairs"),
        )  # fmt: skip
        total, kept = sum(map(len, matches.values())), sum(verified.values())
        supported = sum(count > 0 for count in verified.values())
        self.say(f"{len(matches)} pairs: {total} matches, of which {kept} in {supported} pairs fit a geometry")
        (out / "sparse").mkdir()
        models = map_database(
            out / "database.db", self._args.folder, out / "sparse",
            refine=self._args.calibration is None or self._args.refine_intrinsics, threads=self._args.threads,
            progress=lambda count: self.say(f"{count} images placed"),
        )  # fmt: skip
        self._draw(models[0], len(found), out / "reconstruction.png")
        self._say_result(models, len(found))
        warnings = self._warnings(models, cameras)
        pairs = {"count": len(matches), "matches": total, "verified_matches": kept, "verified_pairs": supported}
        return self._summary(models, found, pairs) | {"warnings": warnings}

    def _matches(self, found: Mapping[str, Features]) -> dict[tuple[str, str], Matches]:
        pairs = self._pairs(found)
        matches = {}
        for a, b in pairs:
            matches[a, b] = Matches.between(found[a], found[b], self._args.ratio)
            self._say_now_and_then(f"matched {len(matches)} of {len(pairs)} pairs")
        return matches

    def _pairs(self, found: Mapping[str, Features]) -> list[Pair]:
        """Which images are matched, by --pairs; of a list those whose images could be read."""
        names, choice = list(found), Choice.of(self._args.pairs)
        if choice.file is not None:
            listed = read_list(choice.file, self._args.folder)
            pairs = [(_name(a, self._args.folder), _name(b, self._args.folder)) for a, b in listed]
            return [pair for pair in pairs if all(name in found for name in pair)]
        if choice.kind == "nearest":
            pooled = np.stack([global_descriptor(features) for features in found.values()])
            return [(names[i], names[j]) for i, j in nearest_pairs(pooled, choice.count)]
        return sequential(names, choice.count) if choice.kind == "sequential" else exhaustive(names)

    def _cameras(self, found: Mapping[str, Features]) -> dict[str, Camera]:
        args, sizes = self._args, {name: features.image_size for name, features in found.items()}
        if args.calibration is None:
            focals = {name: focal_length_px(args.folder / name) for name in sizes}
        else:
            focals = dict.fromkeys(sizes)
        calibration = calibration_of(args.calibration, next(iter(sizes.values())))
        cameras = shared_cameras(sizes, args.share, calibration, focals)
        users: dict[Camera, int] = {}
        for camera in cameras.values():
            users[camera] = users.get(camera, 0) + 1
        origin = "as given" if args.calibration else "from EXIF data"
        guess = "a guess, as there are no EXIF data"
        for camera, count in list(users.items())[:_MOST_CAMERAS]:
            height, width = camera.image_size
            why = origin if camera.focal_known else guess
            self.say(f"camera of {_images(count)}, {width}x{height}: {_focal(camera)}, {why}")
        if len(users) > _MOST_CAMERAS:
            self.say(f"... {len(users)} cameras in all")
        return cameras

    def _draw(self, model: Model, images: int, path: Path) -> None:
        poses = list(model.poses.values())
        rotations, centers = (np.array([getattr(pose, name) for pose in poses]) for name in ("rotation", "center"))
        name, counts = real(self._args.folder).name, f"{len(poses)} of {images} images, {len(model.xyz)} points"
        write_picture(path, scene_picture(model.xyz, model.colors, rotations, centers, name, counts))

    def _say_result(self, models: Sequence[Model], images: int) -> None:
        first, *others = models
        for number, other in enumerate(others, 1):
            self.say(f"sparse/{number}: another {len(other.poses)} images, which do not hang together with the first")
        cameras = list(dict.fromkeys(first.cameras.values()))
        for camera in cameras[:_MOST_CAMERAS]:
            params = ", ".join(f"{value:.6g}" for value in camera.params)
            self.say(f"camera: {camera.model} {params}")
        self.say(
            f"{len(first.poses)} of {images} images registered, {len(first.xyz)} points, each in "
            f"{first.track_length:.2f} images on average, mean reprojection error {first.reprojection_error:.3f} px"
        )

    def _warnings(self, models: Sequence[Model], start: Mapping[str, Camera]) -> list[str]:
        """Said and returned: what is improbable of the cameras, and what helps."""
        helps = "give --K" if self._args.share == "all" else "--share all helps if one camera took them, else --K"
        found = [
            f"{doubt}; the model may be wrong, {helps}" for model in models for doubt in doubts(model.cameras, start)
        ]
        for text in found[: 0 if self._args.quiet else _MOST_CAMERAS]:
            say(f"elf-reconstruct: warning: {text}", sys.stderr)
        return found

    def _summary(
        self, models: Sequence[Model], found: Mapping[str, Features], pairs: Mapping[str, int]
    ) -> dict[str, Any]:
        first = models[0]
        numbers = {camera: number for number, camera in enumerate(dict.fromkeys(first.cameras.values()))}
        return {
            "images": {
                name: {"keypoints": len(features)} | _place(first, name, numbers) for name, features in found.items()
            },
            "registered": len(first.poses),
            "points": len(first.xyz),
            "track_length": first.track_length,
            "reprojection_error": first.reprojection_error,
            "cameras": [camera_data(camera) for camera in numbers],
            "models": [len(model.poses) for model in models],
            "ratio": self._args.ratio,
            "pairs": {"rule": self._args.pairs, **pairs},
        }


def pose_data(pose: Pose) -> dict[str, Any]:
    """World to camera, as COLMAP's text files have it, and the camera's place."""
    return {"qvec": pose.qvec.tolist(), "tvec": pose.translation.tolist(), "center": pose.center.tolist()}


def camera_data(camera: Camera) -> dict[str, Any]:
    return {"model": camera.model, "params": list(camera.params), "size": list(camera.image_size)}


def _place(model: Model, name: str, numbers: Mapping[Camera, int]) -> dict[str, Any]:
    if name not in model.poses:
        return {"registered": False}
    return {"registered": True, "camera": numbers[model.cameras[name]], **pose_data(model.poses[name])}


def _name(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix()


def _images(count: int) -> str:
    return f"{count} image{'s' * (count != 1)}"


def _focal(camera: Camera) -> str:
    return f"{camera.model}, focal length {camera.params[0]:.6g} px"
