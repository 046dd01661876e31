"""Depth maps: where a point of one image lies in the other, and what stands in front of it there."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from elf_eval.coordinates import Float, Size, warp
from elf_eval.errors import EvalError, reason

# A point whose depth differs from the other image's depth map by more than this share lies behind something.
OCCLUSION = 0.05


def through_depth(
    points: Float,
    depth1: npt.NDArray[np.float32],
    depth2: npt.NDArray[np.float32],
    k1: Float,
    k2: Float,
    transform: Float,
) -> Float:
    """Where points of image 1 lie in image 2: x2 ~ K2 (R (z K1^-1 x1) + t).

    Parameters
    ----------
    points : (N, 2)
        Pixels of file 1.

    Returns
    -------
    (N, 2) float64
        Pixels of file 2; NaN where depth 1 is unknown, the point lies behind camera 2, or something stands in
        front of it there (`OCCLUSION`).
    """
    z = depth_at(depth1, points)
    rays = np.column_stack([points, np.ones(len(points))]) @ np.linalg.inv(k1).T
    there = (rays * z[:, None]) @ transform[:3, :3].T + transform[:3, 3]
    image = warp(k2, there[:, :2] / np.where(there[:, 2:] > 0.0, there[:, 2:], np.nan))
    seen = depth_at(depth2, image)
    hidden = np.abs(seen - there[:, 2]) > OCCLUSION * there[:, 2]
    image[hidden] = np.nan
    return image


def depth_at(depth: npt.NDArray[np.float32], points: Float) -> Float:
    """(N,) depth at the nearest pixel; NaN outside the map or where it is unknown."""
    height, width = depth.shape
    known: npt.NDArray[np.bool_] = np.asarray(np.isfinite(points).all(axis=1))
    column, row = np.rint(np.where(known[:, None], points, -1.0)).astype(np.int64).T
    within = known & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    z = np.full(len(points), np.nan)
    z[within] = depth[row[within], column[within]]
    return np.where(z > 0.0, z, np.nan)


@lru_cache(maxsize=4)
def read_depth(path: Path) -> npt.NDArray[np.float32]:
    """(H, W) of a ``.npy`` file, or of a ``.bin`` file of COLMAP's dense stereo.

    Raises
    ------
    EvalError
        If there is no such array in it.
    """
    if path.suffix == ".bin":
        return _read_colmap(path)
    try:
        depth = np.load(path, allow_pickle=False)
    except (OSError, EOFError, ValueError) as error:
        raise EvalError(f"{path}: not a depth map (.npy): {reason(error)}") from error
    if not isinstance(depth, np.ndarray) or depth.dtype.kind not in "fiu" or depth.ndim != 2:
        found = f"{depth.dtype} {depth.shape}" if isinstance(depth, np.ndarray) else "an archive of arrays"
        raise EvalError(f"{path}: a depth map is numbers of shape (H, W), not {found}")
    return np.asarray(depth, np.float32)


def depth_size(path: Path) -> Size:
    """(width, height) of a depth map's file."""
    if path.suffix == ".bin":
        return _colmap_header(path)[0]
    height, width = read_depth(path).shape
    return width, height


def _colmap_header(path: Path) -> tuple[Size, int]:
    """(width, height), and where the values begin: ``WIDTH&HEIGHT&1&`` stands before them."""
    try:
        with open(path, "rb") as file:
            head = file.read(64)
    except OSError as error:
        raise EvalError(f"{path}: {reason(error)}") from error
    match = re.match(rb"(\d+)&(\d+)&1&", head)
    if match is None:
        raise EvalError(f"{path}: not a depth map of COLMAP's: it does not begin with WIDTH&HEIGHT&1&")
    return (int(match[1]), int(match[2])), match.end()


def _read_colmap(path: Path) -> npt.NDArray[np.float32]:
    (width, height), begin = _colmap_header(path)
    values = np.fromfile(path, "<f4", offset=begin)
    if values.size != width * height:
        raise EvalError(f"{path}: {values.size} values, and not {width}x{height}")
    return values.reshape(height, width).astype(np.float32)
