"""Scenes with a model of COLMAP's, which says where each photograph was taken; as COLMAP's undistorter leaves them.

    root/images/NAME.jpg, ..., root/sparse/ (or sparse/0/): cameras, images and points3D, binary or text
    [root/stereo/depth_maps/NAME.jpg.geometric.bin: depth, or NAME.depth.npy beside the image]

Reading a model needs pycolmap, the extra ``sfm``.
"""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np

from elf_eval.coordinates import Float, Size
from elf_eval.errors import EvalError
from elf_eval.spec import Spec
from elf_runtime.errors import ElfError
from elf_runtime.reconstruction.cameras import Camera
from elf_runtime.reconstruction.database import HALF
from elf_runtime.reconstruction.model import Model, Pose, read_model

from .dataset import Dataset, Pair
from .depth import depth_size
from .files import folders_in, scene_name
from .images import ImageRef
from .truth import Calibrated

_IMAGES, _SPARSE, _DEPTHS = "images", "sparse", "stereo/depth_maps"
_WITHOUT_DISTORTION = {"PINHOLE": (0, 1, 2, 3), "SIMPLE_PINHOLE": (0, 0, 1, 2)}  # of fx, fy, cx, cy


def colmap(spec: Spec) -> Dataset:
    """``colmap:FOLDER``, a scene or a folder of them; options ``shared=N`` and ``step=N``.

    Every image with every other one that shows at least ``shared=30`` of the same points of the model.  ``step=N``
    takes only images that are at most N apart in the order of their names.

    Raises
    ------
    EvalError
        Also where pycolmap is not there, an image of the model is missing, cameras have a distortion, or a scene has no
        pair.
    """
    shared = spec.take("shared", int, 30)
    step = spec.take("step", int, 0)
    root = spec.folder()
    pairs: list[Pair] = []
    for scene in [root] if (root / _SPARSE).is_dir() else folders_in(root):
        with spec.whole(scene_name(scene)):
            pairs += _scene_pairs(scene, shared, step)
    return Dataset("colmap", tuple(pairs))


def _scene_pairs(scene: Path, shared: int, step: int) -> list[Pair]:
    folder = scene / _SPARSE
    try:
        model = read_model(folder / "0" if (folder / "0").is_dir() else folder)
    except ElfError as error:
        raise EvalError(str(error)) from error
    views = {name: _View(scene, name, model) for name in sorted(model.poses)}
    points = {name: set(model.tracks[name][model.tracks[name] >= 0].tolist()) for name in views}
    pairs = [
        views[a].pair(views[b])
        for (i, a), (j, b) in combinations(enumerate(views), 2)
        if len(points[a] & points[b]) >= shared and (not step or j - i <= step)
    ]
    if not pairs:
        near = f" at most {step} apart" if step else ""
        raise EvalError(f"{scene}: of its {len(views)} images no two{near} show {shared} of the same points (shared=N)")
    return pairs


class _View:
    """An image of a model, with its camera and its depth map."""

    def __init__(self, scene: Path, name: str, model: Model) -> None:
        path = scene / _IMAGES / name
        if not path.is_file():
            raise EvalError(f"{path}: no such image, and the model in {scene / _SPARSE} has it")
        self.scene = scene_name(scene)
        self.ref = ImageRef(f"{self.scene}/{name}", path)
        camera = model.cameras[name]
        self.intrinsics = intrinsics(camera, path)
        self.pose: Pose = model.poses[name]
        self.depth = _depth(scene, path, name, (camera.image_size[1], camera.image_size[0]))

    def pair(self, other: _View) -> Pair:
        transform = _matrix(other.pose) @ np.linalg.inv(_matrix(self.pose))
        k1, k2, there = (tuple(matrix.ravel().tolist()) for matrix in (self.intrinsics, other.intrinsics, transform))
        return Pair(self.scene, self.ref, other.ref, Calibrated(k1, k2, there, self.depth, other.depth))


def intrinsics(camera: Camera, path: Path) -> Float:
    """(3, 3), integers are pixels' centres; EvalError where the camera has a distortion."""
    if camera.model not in _WITHOUT_DISTORTION:
        raise EvalError(
            f"{path}: its camera is {camera.model}, with a distortion; undistort the images (image_undistorter)"
        )
    fx, fy, cx, cy = (camera.params[index] for index in _WITHOUT_DISTORTION[camera.model])
    return np.array([[fx, 0.0, cx - HALF], [0.0, fy, cy - HALF], [0.0, 0.0, 1.0]])


def _matrix(pose: Pose) -> Float:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = pose.rotation, pose.translation
    return matrix


def _depth(scene: Path, image: Path, name: str, size: Size) -> Path | None:
    places = (image.with_suffix(".depth.npy"), scene / _DEPTHS / f"{name}.geometric.bin")
    found = next((place for place in places if place.is_file()), None)
    if found is not None and depth_size(found) != size:
        width, height = depth_size(found)
        raise EvalError(f"{found}: a depth map of {width}x{height} for {name} of {size[0]}x{size[1]} pixels")
    return found
