"""COLMAP's database: cameras, keypoints, matches, and the matches that one geometry of a pair explains."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_runtime.errors import SettingError, suggestion
from elf_runtime.files.write import write_atomically
from elf_runtime.results.features import Features
from elf_runtime.results.matches import Matches

from .cameras import Calibration, Camera, Size, shared_cameras
from .library import SEED, quiet

HALF = 0.5  # COLMAP's first pixel has its centre at (0.5, 0.5), that of Features at (0, 0)
MOST_ERROR = 4.0  # pixels, of an inlier: COLMAP's own

Indices = npt.NDArray[np.int64]


def write_database(
    path: str | os.PathLike[str],
    images: Mapping[str, Features],
    matches: Mapping[tuple[str, str], Matches | Indices],
    cameras: Mapping[str, Camera] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[tuple[str, str], int]:
    """Write a database that COLMAP and pycolmap open and map.

    Each pair's matches are verified by COLMAP's estimator: by a fundamental matrix; where both focal lengths are known
    by an essential matrix, unless it explains clearly fewer of them than a fundamental one; or by a homography, where
    that explains most of what they do.  Descriptors are not written: COLMAP's matchers would take them for
    SIFT's.

    Parameters
    ----------
    path : path
        Replaced where it exists.
    images : mapping
        The name of each image, relative to the folder of images and with ``/`` -> its features, of the pixels as they
        are stored (``image.read(path, ignore_exif=True)``).
    matches : mapping
        Two names -> their matches, or (K, 2) indices into their features.
    cameras : mapping, optional
        Name -> camera; by default `shared_cameras`: one for each folder, guessed.
    progress : function, optional
        Called with the number of pairs that are done, and of all.

    Returns
    -------
    dict
        Two names -> how many of their matches are inliers; 0 where no geometry explains them.

    Raises
    ------
    ElfError
        If pycolmap is not there.
    SettingError
        If COLMAP does not know a camera's model, it has other parameters, or an image another size; if matches are not
        of these images, or of one pair both ways round.
    OSError
        If the file can't be written.
    """
    given = shared_cameras({name: found.image_size for name, found in images.items()}) if cameras is None else cameras
    _check_cameras(images, given)
    pairs = {names: _indices(names, found, images) for names, found in matches.items()}
    if both := next((names for names in pairs if names[::-1] in pairs), None):
        raise SettingError(f"matches of {both[0]} and {both[1]} are given both ways round; leave one of them out")
    inliers: dict[tuple[str, str], int] = {}

    def write(part: Path) -> None:
        with quiet() as colmap, colmap.Database.open(os.fspath(part)) as database:
            with colmap.DatabaseTransaction(database):
                placed = _write_images(colmap, database, images, given)
            for done, (names, indices) in enumerate(pairs.items(), 1):
                inliers[names] = _write_pair(colmap, database, [placed[name] for name in names], indices)
                if progress:
                    progress(done, len(pairs))

    write_atomically(Path(path), write)
    return inliers


@dataclass(frozen=True)
class _Image:
    """What a pair needs of an image that is in the database."""

    id: int
    points: npt.NDArray[np.float64]
    camera: Any


def _write_images(
    colmap: Any, database: Any, images: Mapping[str, Features], cameras: Mapping[str, Camera]
) -> dict[str, _Image]:
    """Cameras, images and keypoints.  Each camera is a rig of its own, and each image a frame of its rig."""
    rigs: dict[int, tuple[int, Any]] = {}  # a Camera's id() -> of its rig, and as COLMAP's
    written = {}
    for name, features in images.items():
        if id(cameras[name]) not in rigs:
            made = colmap_camera(colmap, cameras[name])
            made.camera_id = database.write_camera(made)
            rig = colmap.Rig()
            rig.add_ref_sensor(made.sensor_id)
            rigs[id(cameras[name])] = database.write_rig(rig), made
        rig_id, camera = rigs[id(cameras[name])]
        image = colmap.Image(name=name, camera_id=camera.camera_id)
        image.image_id = database.write_image(image)
        frame = colmap.Frame()
        frame.rig_id = rig_id
        frame.add_data_id(image.data_id)
        database.write_frame(frame)
        database.write_keypoints(image.image_id, _keypoints(features))
        written[name] = _Image(image.image_id, features.keypoints.astype(np.float64) + HALF, camera)
    return written


def _keypoints(features: Features) -> npt.NDArray[np.float32]:
    """(N, 4): x, y, scale (1 for the smallest size), orientation in radians (0 for none)."""
    scales = features.sizes / features.sizes.min(initial=np.inf)
    angles = np.radians(np.maximum(features.angles, 0))
    return np.column_stack([features.keypoints + np.float32(HALF), scales, angles]).astype(np.float32)


def _write_pair(colmap: Any, database: Any, images: Sequence[_Image], indices: Indices) -> int:
    """The matches of two images, and the inliers of their geometry, which are counted."""
    first, second = images
    database.write_matches(first.id, second.id, indices.astype(np.uint32))
    options = colmap.TwoViewGeometryOptions()
    options.ransac.max_error, options.ransac.random_seed = MOST_ERROR, SEED
    geometry = colmap.estimate_two_view_geometry(
        first.camera, first.points, second.camera, second.points, indices.astype(np.uint32), options
    )
    database.write_two_view_geometry(first.id, second.id, geometry)
    return len(geometry.inlier_matches)


def check_calibration(calibration: Calibration, image_size: Size | None = None) -> None:
    """Refuse intrinsics that COLMAP does not take, of images of (height, width) pixels where that is given.

    Raises
    ------
    ElfError
        If pycolmap is not there.
    SettingError
        See `colmap_camera`.
    """
    with quiet() as colmap:
        if image_size is not None:
            colmap_camera(colmap, Camera.calibrated(image_size, calibration))
        else:
            _of_known_model(colmap, Camera.calibrated((1, 1), calibration))


def colmap_camera(colmap: Any, camera: Camera) -> Any:
    """A camera as pycolmap has it.

    Raises
    ------
    SettingError
        If COLMAP has no such model, or the model other parameters; if no images of this size have such ones.
    """
    height, width = camera.image_size
    made = _of_known_model(colmap, camera)
    inside = 0 < made.principal_point_x < width and 0 < made.principal_point_y < height
    if made.has_bogus_params(0.1, 10.0, 10.0) or not inside:
        raise SettingError(f"camera {_text(camera)}: this can't be the camera of images of {width}x{height} pixels")
    return made


def _text(camera: Camera) -> str:
    return f"{camera.model}:{','.join(f'{value:g}' for value in camera.params)}"


def _of_known_model(colmap: Any, camera: Camera) -> Any:
    (height, width), text = camera.image_size, _text(camera)
    if camera.model not in colmap.CameraModelId.__members__ or camera.model == "INVALID":
        known = [name for name in colmap.CameraModelId.__members__ if name != "INVALID"]
        near = suggestion(camera.model, known)
        raise SettingError(f"camera {text}: COLMAP's models are {', '.join(known)}{near}")
    made = colmap.Camera(model=camera.model, width=width, height=height, params=list(camera.params))
    made.has_prior_focal_length = camera.focal_known
    if not made.verify_params():
        raise SettingError(f"camera {text}: the parameters of {camera.model} are {made.params_info}")
    return made


def _check_cameras(images: Mapping[str, Features], cameras: Mapping[str, Camera]) -> None:
    for name, features in images.items():
        if name not in cameras:
            raise SettingError(f"{name} has no camera")
        sizes = [f"{width}x{height}" for height, width in (features.image_size, cameras[name].image_size)]
        if sizes[0] != sizes[1]:
            raise SettingError(f"{name} has {sizes[0]} pixels, and its camera {sizes[1]}")


def _indices(names: tuple[str, str], found: Matches | Indices, images: Mapping[str, Features]) -> Indices:
    """(K, 2) indices into two images' features, none out of range."""
    if missing := [name for name in names if name not in images]:
        raise SettingError(f"matches of {names[0]} and {names[1]}: there are no features of {missing[0]}")
    if names[0] == names[1]:
        raise SettingError(f"matches of {names[0]} with itself")
    indices = np.asarray(found.indices if isinstance(found, Matches) else found)
    counts = tuple(len(images[name]) for name in names)
    if indices.ndim != 2 or indices.shape[1] != 2 or indices.dtype.kind not in "iu":
        raise SettingError(f"matches are Matches or (K, 2) integers, not {indices.shape} {indices.dtype}")
    if ((indices < 0) | (indices >= counts)).any():
        raise SettingError(
            f"matches of {names[0]} and {names[1]} are not of their {counts[0]} and {counts[1]} features"
        )
    return indices.astype(np.int64)
