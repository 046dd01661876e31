"""A sparse model: where the cameras stood, and the points that they see."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_runtime.errors import ElfError, first_line

from .cameras import Camera
from .library import quiet

Float = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pose:
    """From the world to a camera: a point X of the world is at ``rotation @ X + translation``.

    The camera looks along its z, with x to the right of the image and y down.

    Attributes
    ----------
    rotation : (3, 3)
    translation : (3,)
    qvec : (4,)
        The rotation as COLMAP's text files have it, (w, x, y, z).
    """

    rotation: Float
    translation: Float
    qvec: Float

    @classmethod
    def of_colmap(cls, pose: Any) -> Pose:
        """From pycolmap's Rigid3d."""
        x, y, z, w = pose.rotation.quat
        return cls(np.array(pose.rotation.matrix()), np.array(pose.translation), np.array([w, x, y, z]))

    @property
    def center(self) -> Float:
        """Where the camera is in the world, (3,)."""
        return -self.rotation.T @ self.translation


@dataclass(frozen=True, eq=False)
class Model:
    """What COLMAP's mapper made.  The unit of length and the axes are its own.

    Attributes
    ----------
    poses : dict
        Name of each image that was placed -> its pose, by name.
    cameras : dict
        The same names -> cameras, in COLMAP's pixels.
    xyz : (P, 3)
        The points.
    colors : (P, 3) uint8
        RGB.
    tracks : dict
        Name -> (N,) int64: which point each of the image's keypoints shows, -1 for none.
    track_length : float
        In how many images a point is seen, on average.
    reprojection_error : float
        Pixels between a keypoint and where its point is projected to, on average.
    """

    poses: dict[str, Pose]
    cameras: dict[str, Camera]
    xyz: Float
    colors: npt.NDArray[np.uint8]
    tracks: dict[str, npt.NDArray[np.int64]]
    track_length: float
    reprojection_error: float

    def __repr__(self) -> str:
        return f"Model({len(self.poses)} images, {len(self.xyz)} points)"


def read_model(folder: str | os.PathLike[str]) -> Model:
    """Read a model of COLMAP's: a folder of cameras, images and points3D, binary or text.

    Raises
    ------
    ElfError
        If pycolmap is not there, or the folder holds no model.
    """
    if not any(Path(folder, f"images.{ending}").is_file() for ending in ("bin", "txt")):
        raise ElfError(f"{os.fsdecode(folder)}: no model of COLMAP's in this folder (images.bin)")
    with quiet() as colmap:
        try:
            found = colmap.Reconstruction(os.fspath(folder))
        except Exception as error:  # pycolmap's checks raise what C++ has
            raise ElfError(f"{os.fsdecode(folder)}: not a model of COLMAP's: {first_line(error)}") from error
        return model_of(found)


def model_of(found: Any) -> Model:
    """From pycolmap's Reconstruction."""
    rows = {point_id: row for row, point_id in enumerate(found.points3D)}
    points = list(found.points3D.values())
    images = sorted((found.images[image_id] for image_id in found.reg_image_ids()), key=lambda image: image.name)
    cameras = {camera_id: _camera(camera) for camera_id, camera in found.cameras.items()}
    return Model(
        {image.name: Pose.of_colmap(image.cam_from_world()) for image in images},
        {image.name: cameras[image.camera_id] for image in images},
        np.array([point.xyz for point in points], np.float64).reshape(-1, 3),
        np.array([point.color for point in points], np.uint8).reshape(-1, 3),
        {image.name: _track(image, rows) for image in images},
        float(found.compute_mean_track_length()) if points else 0.0,
        float(found.compute_mean_reprojection_error()) if points else 0.0,
    )


def _camera(camera: Any) -> Camera:
    params = tuple(float(value) for value in camera.params)
    return Camera(str(camera.model_name), params, (camera.height, camera.width), True)


def _track(image: Any, rows: dict[int, int]) -> npt.NDArray[np.int64]:
    shown = [rows[point.point3D_id] if point.has_point3D() else -1 for point in image.points2D]
    return np.array(shown, np.int64)
