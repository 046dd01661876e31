"""A picture of a reconstructed scene: its points and cameras, from above and from behind the cameras."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .canvas import DARK, Color, Picture, line, side_by_side, titled

Float = npt.NDArray[np.float64]

CAMERA: Color = (90, 210, 60)
_WIDTH, _MARGIN = 800, 30  # pixels of a panel
_SHAPES = (0.4, 1.2)  # lowest and highest panel, in widths
_KEPT = (1.0, 99.0)  # percentiles of the points that fit into the picture: a few always lie far off
_FRUSTUM = 0.05  # of a panel's extent: a drawn camera's depth
_DARKEST = 100  # levels; darker points would vanish on the dark ground
# A camera's place, and the corners of its image at depth 1.
_CORNERS = np.array([[0, 0, 0], [-0.6, -0.45, 1], [0.6, -0.45, 1], [0.6, 0.45, 1], [-0.6, 0.45, 1]])
_EDGES = ((0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1))


def scene_picture(
    xyz: Float, colors: npt.NDArray[np.uint8], rotations: Float, centers: Float, title: str, counts: str = ""
) -> Picture:
    """Points in their colours, and cameras as green pyramids, in two parallel projections side by side.

    What the cameras on average have below them is down; the second picture looks the way that they look on average.

    Parameters
    ----------
    xyz : (P, 3)
    colors : (P, 3) uint8, RGB
    rotations : (N, 3, 3)
        From the world to each camera, which looks along its z with y down; N >= 1.
    centers : (N, 3)
        Where they are.
    title, counts : str
        Of the first panel: a name, and what stands behind it.
    """
    right, down, ahead = axes = _axes(rotations)
    corners = centers[:, None] + _FRUSTUM * _extent(xyz, centers, axes) * (_CORNERS @ rotations)
    bgr = np.maximum(colors[:, ::-1], _DARKEST)
    panels = []
    above = (f"{title} from above" if title else "from above", counts)
    views = (((right, -ahead, down), above), ((right, down, ahead), ("as the cameras look", "")))
    for (across, along, depth), texts in views:
        order = np.argsort(-(xyz @ depth), kind="stable")  # the nearest last, on top
        plane = np.stack([across, along], axis=1)
        panels.append(titled(_panel(xyz[order] @ plane, bgr[order], corners @ plane), *texts))
    return side_by_side(panels)


def _axes(rotations: Float) -> Float:
    """Right, down and ahead of the cameras on average, (3, 3): orthogonal unit rows."""
    down = rotations[:, 1].mean(axis=0)
    down = _unit(down, rotations[0, 1])
    ahead = rotations[:, 2].mean(axis=0)
    ahead = _unit(ahead - down * (ahead @ down), np.cross(rotations[0, 0], down))
    return np.stack([np.cross(down, ahead), down, ahead])


def _unit(vector: Float, other: Float) -> Float:
    """Of unit length; `other` where cameras that look all ways leave nothing of the average."""
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-3 else other / np.linalg.norm(other)


def _extent(xyz: Float, centers: Float, axes: Float) -> float:
    low, high = _bounds(xyz @ axes.T, centers @ axes.T)
    return float((high - low).max())


def _bounds(points: Float, always: Float) -> tuple[Float, Float]:
    """The box of most of the points, and of all that `always` has."""
    inner = np.percentile(points, _KEPT, axis=0) if len(points) else always
    both = np.concatenate([inner, always])
    return both.min(axis=0), both.max(axis=0)


def _panel(points: Float, bgr: npt.NDArray[np.uint8], cameras: Float) -> Picture:
    """Points (P, 2) and pyramids (N, 5, 2), to one scale, on a dark ground."""
    low, high = _bounds(points, cameras.reshape(-1, 2))
    size = np.maximum(high - low, 1e-9)
    inside = _WIDTH - 2 * _MARGIN
    scale = min(inside / size[0], (_SHAPES[1] * _WIDTH - 2 * _MARGIN) / size[1])
    height = round(max(_SHAPES[0] * _WIDTH, size[1] * scale + 2 * _MARGIN))
    shift = np.array([_WIDTH, height]) / 2 - scale * (low + high) / 2
    picture = np.full((height, _WIDTH, 3), DARK, np.uint8)
    x, y = np.rint(points * scale + shift).astype(np.int64).T
    shown = (x >= 1) & (y >= 1) & (x < _WIDTH - 1) & (y < height - 1)
    for dx, dy in ((0, 0), (1, 0), (0, 1), (-1, 0), (0, -1)):
        picture[y[shown] + dy, x[shown] + dx] = bgr[shown]
    for pyramid in cameras * scale + shift:
        for a, b in _EDGES:
            line(picture, pyramid[a], pyramid[b], CAMERA)
    return picture
