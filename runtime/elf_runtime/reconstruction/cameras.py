"""The cameras of a scene: which images share one, and what is known of its focal length and distortion."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

from elf_runtime.errors import SettingError
from elf_runtime.geometry.cameras import Cameras

Size = tuple[int, int]
SHARES = ("folder", "all", "image")
GUESSED_MODEL = "SIMPLE_RADIAL"  # one focal length, one coefficient of distortion
FURTHEST = 2.0  # an estimated focal length, from where the search for it began
_MOST_APART = 1.5  # two of images of one size, which are likely to be of one camera
_MOST_DISTORTION = 0.5
GUESSED_FOCAL = 1.2  # times the longer side: COLMAP's guess, an angle of view of 45 degrees


@dataclass(frozen=True)
class Calibration:
    """Known intrinsics, by COLMAP's name of a camera model and its parameters.

    In COLMAP the centre of the first pixel is at (0.5, 0.5), and so the principal point is half a pixel beyond
    OpenCV's; `of_matrix` adds it.
    """

    model: str
    params: tuple[float, ...]

    @classmethod
    def of_matrix(cls, K: Any) -> Calibration:
        """From OpenCV's (3, 3) matrix, without skew, to the pixels that integers are the centres of.

        Raises
        ------
        SettingError
            If it is no calibration matrix, or has skew.
        """
        matrix = Cameras.of(K).first
        if matrix[0, 1]:
            raise SettingError(f"COLMAP's cameras have no skew, and K's is {matrix[0, 1]:g}")
        return cls("PINHOLE", tuple(map(float, (matrix[0, 0], matrix[1, 1], matrix[0, 2] + 0.5, matrix[1, 2] + 0.5))))

    @classmethod
    def parse(cls, text: str) -> Calibration:
        """From ``MODEL:p1,p2,...`` in COLMAP's names and order, such as ``OPENCV:fx,fy,cx,cy,k1,k2,p1,p2``.

        Raises
        ------
        SettingError
            If the text is none of this form.  Whether COLMAP knows the model is asked when a camera is written.
        """
        model, _, numbers = text.partition(":")
        try:
            params = tuple(float(number) for number in numbers.split(","))
        except ValueError:
            params = ()
        if not model.strip() or not params or not all(map(math.isfinite, params)):
            raise SettingError(f"{text!r} is not MODEL:p1,p2,..., such as PINHOLE:fx,fy,cx,cy")
        return cls(model.strip().upper(), params)


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera at one zoom.  Images that have the same instance share it.

    Attributes
    ----------
    model, params
        As COLMAP's, see `Calibration`.
    image_size : (height, width)
        Of the images as they are stored.
    focal_known : bool
        Whether the focal length is more than a guess: from a calibration, or from EXIF data.
    """

    model: str
    params: tuple[float, ...]
    image_size: Size
    focal_known: bool = False

    @classmethod
    def guessed(cls, image_size: Size, focal: float | None = None) -> Camera:
        """A SIMPLE_RADIAL camera: with `focal`, in pixels, or 1.2 times the longer side; the centre; no distortion."""
        height, width = image_size
        length = GUESSED_FOCAL * max(height, width) if focal is None else float(focal)
        return cls(GUESSED_MODEL, (length, width / 2, height / 2, 0.0), image_size, focal is not None)

    @classmethod
    def calibrated(cls, image_size: Size, calibration: Calibration) -> Camera:
        return cls(calibration.model, calibration.params, image_size, True)


def shared_cameras(
    sizes: Mapping[str, Size],
    share: str = "folder",
    calibration: Calibration | None = None,
    focals: Mapping[str, float | None] | None = None,
) -> dict[str, Camera]:
    """A camera for each image.

    Parameters
    ----------
    sizes : mapping
        Image's name, with its folder -> (height, width) as stored.
    share : "folder", "all" or "image"
        The images of a folder have one camera, or all images, or each its own.  Images of a folder that differ in size
        or in focal length come from several.
    calibration : Calibration, optional
        Known intrinsics, of all images.
    focals : mapping, optional
        Name -> focal length in pixels, None where it is unknown; see `image.exif.focal_length_px`.  Without a
        calibration they are where the search begins.

    Raises
    ------
    SettingError
        If images differ in size where all share a camera, or a calibration is given.
    """
    if share not in SHARES:
        raise SettingError(f"cameras are shared by {', '.join(SHARES)}, not {share!r}")
    if calibration is not None or share == "all":
        _check_one_size(sizes, "a calibration is of one size" if calibration else "one camera takes images of one size")
    known = dict(focals or {})
    groups: dict[tuple[object, ...], list[str]] = {}
    for name, size in sizes.items():
        whole = {"folder": (str(PurePosixPath(name).parent), size, known.get(name)), "all": (), "image": (name,)}
        groups.setdefault(whole[share], []).append(name)
    cameras: dict[str, Camera] = {}
    for names in groups.values():
        if calibration is not None:
            camera = Camera.calibrated(sizes[names[0]], calibration)
        else:
            camera = Camera.guessed(sizes[names[0]], _middle(known.get(name) for name in names))
        cameras |= dict.fromkeys(names, camera)
    return {name: cameras[name] for name in sizes}


def doubts(estimated: Mapping[str, Camera], start: Mapping[str, Camera]) -> list[str]:
    """What makes estimated intrinsics improbable, and with them the model; empty where nothing does.

    They are so where a focal length is twice or half of what the search began with, where the coefficient of distortion
    is above 0.5, and where focal lengths of images of one size are 1.5 times apart.

    Parameters
    ----------
    estimated : mapping
        Image's name -> camera, as a model has them.
    start : mapping
        Of at least the same names.  What did not change is in no doubt.

    Returns
    -------
    list of str
        Each camera once, by its first image.
    """
    found: list[str] = []
    focals: dict[Size, list[float]] = {}
    seen: set[Camera] = set()
    for name, camera in estimated.items():
        if camera in seen or camera.params == start[name].params:
            continue
        seen.add(camera)
        length, began = camera.params[0], start[name].params[0]
        focals.setdefault(camera.image_size, []).append(length)
        if max(length / began, began / length) > FURTHEST:
            found.append(f"{name}: focal length {length:.6g} px, where the search began with {began:.6g}")
        if camera.model == GUESSED_MODEL and abs(camera.params[3]) > _MOST_DISTORTION:
            found.append(f"{name}: coefficient of distortion {camera.params[3]:.3g}")
    for (height, width), lengths in focals.items():
        low, high = min(lengths), max(lengths)
        if high > _MOST_APART * low:
            found.append(f"images of {width}x{height} pixels: focal lengths from {low:.6g} to {high:.6g} px")
    return found


def _middle(focals: Iterable[float | None]) -> float | None:
    known = [focal for focal in focals if focal is not None]
    return statistics.median(known) if known else None


def _check_one_size(sizes: Mapping[str, Size], why: str) -> None:
    first: dict[Size, str] = {}
    for name, size in sizes.items():
        first.setdefault(size, name)
    if len(first) > 1:
        (a, one), (b, two) = [(name, f"{size[1]}x{size[0]}") for size, name in first.items()][:2]
        raise SettingError(f"{why}, and {a} has {one} pixels, {b} {two}")
