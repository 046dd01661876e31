"""Strecha's multi-view stereo scenes: images, one ``.camera`` file each, and optional depth maps.

    root/fountain/0000.png, 0000.png.camera, [0000.depth.npy], ...

A ``.camera`` file holds K (3x3), three numbers of radial distortion, R (3x3), the centre C (3) and the
image's width and height; a point X of the world lies at K R^T (X - C).
"""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np

from elf_eval.errors import EvalError, reason
from elf_eval.geometry import Float
from elf_eval.images import ImageRef
from elf_eval.spec import Spec
from elf_eval.truth import Calibrated

from .base import Dataset, Pair
from .files import folders_in, images_in, is_image


def strecha(spec: Spec) -> Dataset:
    """``strecha:FOLDER``; option ``step=N`` pairs images at most N apart (all pairs by default).

    With depth maps the paper's metrics are there too (3D viewpoint); without them, relative pose alone.
    """
    step = spec.take("step", int, 0)
    root = spec.folder()
    scenes = [root] if any(is_image(p) for p in root.iterdir()) else folders_in(root)
    pairs: list[Pair] = []
    for scene in scenes:
        views = [(path, *read_camera(_camera_file(path))) for path in images_in(scene)]
        for (i, a), (j, b) in combinations(enumerate(views), 2):
            if not step or j - i <= step:
                pairs.append(_pair(scene.name, a, b))
    return Dataset("strecha", tuple(pairs))


def read_camera(path: Path) -> tuple[Float, Float]:
    """Intrinsics (3, 3), and the (4, 4) transform from world to camera coordinates.

    Raises
    ------
    EvalError
        If the file is missing, has not 24 or 26 numbers, or its rotation is none.
    """
    try:
        numbers = np.array(path.read_text().split(), np.float64)
    except (OSError, ValueError) as error:
        raise EvalError(f"{path}: not a .camera file: {reason(error)}") from error
    if numbers.size not in (24, 26):  # with or without the image's size
        raise EvalError(
            f"{path}: expected K, distortion, R, C [and the size]: 24 or 26 numbers, not {numbers.size}"
        )
    if numbers[9:12].any():
        raise EvalError(f"{path}: radial distortion {numbers[9:12]}; undistort the image first")
    rotation, centre = numbers[12:21].reshape(3, 3), numbers[21:24]
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3):
        raise EvalError(f"{path}: numbers 13 to 21 are no rotation matrix")
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = rotation.T
    world_to_camera[:3, 3] = -rotation.T @ centre
    return numbers[:9].reshape(3, 3), world_to_camera


def _pair(scene: str, a: tuple[Path, Float, Float], b: tuple[Path, Float, Float]) -> Pair:
    depths = [path.with_suffix(".depth.npy") for path in (a[0], b[0])]
    depth1, depth2 = (d if d.is_file() else None for d in depths)
    transform = b[2] @ np.linalg.inv(a[2])
    truth = Calibrated(
        tuple(a[1].ravel().tolist()),
        tuple(b[1].ravel().tolist()),
        tuple(transform.ravel().tolist()),
        depth1,
        depth2,
    )
    refs = [ImageRef(f"{scene}/{path.name}", path) for path in (a[0], b[0])]
    return Pair(scene, refs[0], refs[1], truth)


def _camera_file(image: Path) -> Path:
    found = [
        p for p in (image.with_name(image.name + ".camera"), image.with_suffix(".camera")) if p.is_file()
    ]
    if not found:
        raise EvalError(f"{image}: no camera file {image.name}.camera or {image.stem}.camera beside it")
    return found[0]
