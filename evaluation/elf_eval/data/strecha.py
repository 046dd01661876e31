"""Strecha's multi-view stereo scenes: images, one ``.camera`` file each, and optional depth maps.

As their publishers lay them out, or all of a scene in one folder:

    root/entry-P10/images/0000.jpg, ..., root/entry-P10/gt_dense_cameras/0000.jpg.camera, ...
    root/fountain/0000.png, 0000.png.camera, [0000.depth.npy], ...

A ``.camera`` file holds K (3x3), three numbers of radial distortion, R (3x3), the centre C (3) and the
image's width and height; a point X of the world lies at K R^T (X - C).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from elf_eval.coordinates import Float, Size
from elf_eval.errors import EvalError, reason
from elf_eval.spec import Spec

from .dataset import Dataset, Pair
from .depth import read_depth
from .files import folders_in, images_to_pair, is_image, scene_name
from .images import ImageRef, read_image
from .truth import Calibrated

_IMAGES, _CAMERAS = "images", "gt_dense_cameras"  # the publishers' folders


@dataclass(frozen=True)
class _View:
    ref: ImageRef
    intrinsics: Float
    world_to_camera: Float
    depth: Path | None


def strecha(spec: Spec) -> Dataset:
    """``strecha:FOLDER``; options ``pairs=first``, ``step=N`` and ``depth=FOLDER``.

    ``pairs=first`` pairs the first image with each other one (the paper's 26 pairs of its three scenes) instead of
    all with all.  ``step=N`` takes only images that are at most N apart.  With depth maps the paper's metrics are
    there too (3D viewpoint); without them, relative pose and epipolar lines.  They lie beside the images or in the
    scene's folder, or as SCENE/STEM.depth.npy in ``depth=FOLDER``, as `elf-eval depth` writes them.

    Raises
    ------
    EvalError
        Also where an image has another size than its camera file says, or than its depth map; where ``depth=FOLDER``
        has no map of any image; where a scene has no image or only one.
    """
    step = spec.take("step", int, 0)
    which = spec.take("pairs", _which, "all")
    depths = spec.take("depth", Path, None)
    root = spec.folder()
    pairs: list[Pair] = []
    all_views: list[_View] = []
    for scene in [root] if _is_scene(root) else folders_in(root):
        views: list[_View] = []
        with spec.whole(scene_name(scene)):
            views = [_view(scene, path, depths) for path in images_to_pair(_image_folder(scene))]
        all_views += views
        for (i, a), (j, b) in combinations(enumerate(views), 2):
            if (which == "all" or i == 0) and (not step or j - i <= step):
                pairs.append(_pair(scene_name(scene), a, b))
    if depths and not any(view.depth for view in all_views):
        raise EvalError(f"{spec.text}: no depth map SCENE/STEM.depth.npy of any image in {depths}")
    return Dataset("strecha", tuple(pairs))


def _which(text: str) -> str:
    if text not in ("all", "first"):
        raise ValueError("expected all or first")
    return text


def _is_scene(folder: Path) -> bool:
    return (folder / _IMAGES).is_dir() or any(is_image(p) for p in folder.iterdir())


def _image_folder(scene: Path) -> Path:
    return scene / _IMAGES if (scene / _IMAGES).is_dir() else scene


def read_camera(path: Path) -> tuple[Float, Float]:
    """Intrinsics (3, 3), and the (4, 4) transform from world to camera coordinates.

    Raises
    ------
    EvalError
        If the file is missing, does not hold 24 or 26 numbers, or its rotation is not one.
    """
    numbers = _camera_numbers(path)
    if numbers[9:12].any():
        raise EvalError(f"{path}: radial distortion {numbers[9:12]}; undistort the image first")
    rotation, centre = numbers[12:21].reshape(3, 3), numbers[21:24]
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3):
        raise EvalError(f"{path}: numbers 13 to 21 are no rotation matrix")
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = rotation.T
    world_to_camera[:3, 3] = -rotation.T @ centre
    return numbers[:9].reshape(3, 3), world_to_camera


def camera_size(path: Path) -> Size | None:
    """(width, height) of the image that a ``.camera`` file's intrinsics are for; None where the file does not say."""
    numbers = _camera_numbers(path)
    return (int(numbers[24]), int(numbers[25])) if numbers.size == 26 else None


def _camera_numbers(path: Path) -> Float:
    try:
        numbers = np.array(path.read_text(encoding="utf-8").split(), np.float64)
    except (OSError, ValueError) as error:
        raise EvalError(f"{path}: not a .camera file: {reason(error)}") from error
    if numbers.size not in (24, 26):  # with or without the image's size
        raise EvalError(f"{path}: expected K, distortion, R, C [and the size]: 24 or 26 numbers, not {numbers.size}")
    if not np.isfinite(numbers).all():
        raise EvalError(f"{path}: a number is NaN or infinite")
    return numbers


def _view(scene: Path, image: Path, depths: Path | None) -> _View:
    """An image with its camera and depth map; refused where their sizes differ."""
    file = _camera_file(scene, image)
    height, width = read_image(image).shape[:2]
    size = camera_size(file)
    if size is not None and size != (width, height):
        raise EvalError(
            f"{image}: {width}x{height} pixels, but {file.name} is for {size[0]}x{size[1]}; "
            "take the images that the cameras were made for, or scale K and the size in the camera files"
        )
    depth = _depth_file(scene, image, depths)
    if depth is not None:
        rows, columns = read_depth(depth).shape
        if (columns, rows) != (width, height):
            raise EvalError(
                f"{depth}: a depth map of {columns}x{rows} for {image.name} of {width}x{height} pixels; "
                "make it one value for each pixel"
            )
    return _View(_ref(scene, image), *read_camera(file), depth)


def _depth_file(scene: Path, image: Path, depths: Path | None) -> Path | None:
    """The image's depth map, where there is one."""
    folders = [depths / scene_name(scene)] if depths else [image.parent, scene]
    files = [folder / f"{image.stem}.depth.npy" for folder in folders]
    return next((file for file in files if file.is_file()), None)


def _ref(scene: Path, image: Path) -> ImageRef:
    return ImageRef(f"{scene_name(scene)}/{image.name}", image)


def _pair(scene: str, a: _View, b: _View) -> Pair:
    transform = b.world_to_camera @ np.linalg.inv(a.world_to_camera)
    truth = Calibrated(
        tuple(a.intrinsics.ravel().tolist()),
        tuple(b.intrinsics.ravel().tolist()),
        tuple(transform.ravel().tolist()),
        a.depth,
        b.depth,
    )
    return Pair(scene, a.ref, b.ref, truth)


def _camera_file(scene: Path, image: Path) -> Path:
    names = (image.name + ".camera", image.stem + ".camera")
    folders = [image.parent, scene / _CAMERAS]
    found = [folder / name for folder in folders for name in names if (folder / name).is_file()]
    if not found:
        raise EvalError(f"{image}: no camera file {' or '.join(names)} beside it or in {scene / _CAMERAS}")
    return found[0]
