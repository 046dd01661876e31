"""Pictures of what the runtime found: BGR uint8 arrays, for files or windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.image.convert import unused_range
from elf_runtime.image.file import ImageLike

from .canvas import DARK, Color, Picture, circle, distinct_colors, line, side_by_side, strength_colors, titled
from .source import pixels_of

if TYPE_CHECKING:
    from elf_runtime.results.features import Features
    from elf_runtime.results.trace import Trace

INLIER: Color = (90, 210, 60)
OUTLIER: Color = (80, 80, 235)
PASSED: Color = (235, 235, 120)
PANEL = 800  # pixels of an image's longer side, at most


def displayable(image: npt.NDArray[Any]) -> Picture:
    """Any image that the runtime takes, as BGR uint8: (H, W) or (H, W, 1, 3 or 4) -> (H, W, 3).

    uint16 is stretched by `unused_range`, so that the pixels of cameras of 10 to 14 bits are not all dark.
    """
    image = image.astype(image.dtype.newbyteorder("="), copy=False)
    image = image[:, :, :3] if image.ndim == 3 else image
    if image.dtype == np.bool_:
        image = image.astype(np.uint8) * np.uint8(255)
    elif image.dtype == np.uint16:
        image = (image * np.float32(unused_range(image) / 256)).astype(np.uint8)
    elif image.dtype.kind == "f":
        image = (np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.ndim == 2:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
    return np.ascontiguousarray(image)


def heatmap(values: npt.NDArray[np.floating]) -> Picture:
    """A map, (H, W) float >= 0, in perceptual colours from black (0) to bright.

    Bright is the 99.5 % quantile of the values above 0, and beyond: with the maximum in its place, a saliency map's few
    outliers would leave all else dark.
    """
    positive = values[values > 0]
    top = float(np.quantile(positive, 0.995)) if positive.size else 1.0
    levels = (np.clip(values / top, 0.0, 1.0) * 255.0).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_INFERNO), np.uint8)


def draw_keypoints(image: ImageLike, features: Features, color: str = "bgr") -> Picture:
    """The image, greyed and dimmed, with a ring on each keypoint, from weak (violet) to strong (yellow).

    Colours go by the keypoints' rank, so that they spread over the whole scale whatever the scores are.  Rings grow
    with the keypoints' sizes; the smallest size has the same ring whatever `nms_radius` is.

    Parameters
    ----------
    image : array or path, as `ElfRuntime.detect` takes it
        The one that the features came from.
    features : Features
    color : "bgr" or "rgb"
        The order of an array's channels.

    Returns
    -------
    (H, W, 3) uint8
        In BGR, as `cv2.imwrite` takes it, whatever `color` is.

    Raises
    ------
    ImageError
        On an image that `detect` would refuse, or of another size than that of the features.
    SettingError
        If `features` are none, or `color` is another.
    """
    picture = _dimmed(displayable(pixels_of(image, features, color)), 0.75)
    colors = strength_colors(len(features))
    unit = _unit(picture)
    radii = max(2.5, 4.0 * unit) * features.sizes / features.sizes.min(initial=np.inf)
    # The strongest last, on top.
    for (x, y), radius, rank in zip(features.keypoints[::-1], radii[::-1], colors[::-1], strict=True):
        circle(picture, x, y, radius, DARK, round(3 * unit))
        circle(picture, x, y, radius, rank, round(1.5 * unit))
    return picture


def draw_mask(image: npt.NDArray[Any], mask: npt.NDArray[np.bool_]) -> Picture:
    """The pixels that passed the threshold in one bright colour, over the darkened image.

    Parameters
    ----------
    image : (H, W, ...) array
    mask : (h, w) bool
        At the working size; resized to the image's.
    """
    picture = _dimmed(displayable(image), 0.4)
    height, width = picture.shape[:2]
    # An area average, so that a thin line does not vanish where a large picture is shrunk.
    method = cv2.INTER_AREA if mask.shape[0] > height else cv2.INTER_NEAREST
    share = cv2.resize(mask.astype(np.float32), (width, height), interpolation=method)[:, :, None]
    return np.asarray(picture * (1.0 - share) + np.array(PASSED, np.float32) * share, np.uint8)


def detection_picture(image: npt.NDArray[Any], trace: Trace, title: str = "") -> Picture:
    """Keypoints, saliency and threshold side by side, each panel under a title; without levels, keypoints only.

    Parameters
    ----------
    image : (H, W, ...) array
        The source image of `trace`.
    """
    return detection_panels(*fitted(displayable(image)), trace, title)


def detection_panels(view: Picture, factor: float, trace: Trace, title: str = "") -> Picture:
    """`detection_picture` on a view of the source image at `factor` times its size."""
    features = trace.features
    rings = titled(draw_scaled(view, factor, features), title, f"{len(features)} keypoints", legend=True)
    if not trace.levels:
        return side_by_side([rings])
    size = (view.shape[1], view.shape[0])
    heat = cv2.resize(heatmap(trace.saliency), size, interpolation=cv2.INTER_LINEAR)
    share = 100.0 * float(trace.mask.mean())
    panels = [
        rings,
        titled(heat, "saliency S = |F^T dF/dI|"),
        titled(draw_mask(view, trace.mask), f"threshold: {share:.1f} % pass"),
    ]
    return side_by_side(panels)


def draw_scaled(view: Picture, factor: float, features: Features) -> Picture:
    """`draw_keypoints` on the features' image at `factor` times its size."""
    points = ((features.keypoints + 0.5) * factor - 0.5).astype(np.float32)
    return draw_keypoints(view, replace(features, keypoints=points, image_size=view.shape[:2]))


def match_picture(
    images: Sequence[npt.NDArray[Any]],
    points: Sequence[npt.NDArray[np.float32]],
    inliers: npt.NDArray[np.bool_] | None = None,
    titles: Sequence[tuple[str, str]] = (("", ""), ("", "")),
) -> Picture:
    """Two images side by side with a line for each match.

    Parameters
    ----------
    images : two (H, W, ...) arrays
    points : two (M, 2) float32 arrays
        Row i of the one is matched with row i of the other; (x, y) in pixels.
    inliers : (M,) bool, optional
        Inliers are drawn in green over the others' thin red; without it each match has a colour of its own.
    titles : two pairs of texts
        A name, which is cut where there is no room, and what stands behind it.
    """
    views, factors = [], []
    for image in images:
        view, factor = fitted(displayable(image))
        views.append(_dimmed(view, 0.7))
        factors.append(factor)
    panels = [titled(view, *title) for view, title in zip(views, titles, strict=True)]
    picture = side_by_side(panels)
    top = panels[0].shape[0] - views[0].shape[0]
    left = picture.shape[1] - panels[1].shape[1]
    first = (points[0] + 0.5) * factors[0] - 0.5 + (0, top)
    second = (points[1] + 0.5) * factors[1] - 0.5 + (left, top)

    count = len(first)
    good = np.ones(count, np.bool_) if inliers is None else inliers
    colors = [INLIER] * count if inliers is not None else distinct_colors(count)
    lines = picture.copy()
    for i in np.flatnonzero(~good):
        line(lines, first[i], second[i], OUTLIER)
    picture = np.asarray(cv2.addWeighted(picture, 0.7, lines, 0.3, 0.0), np.uint8)
    lines = picture.copy()
    for i in np.flatnonzero(good):
        line(lines, first[i], second[i], colors[i])
    picture = np.asarray(cv2.addWeighted(picture, 0.4, lines, 0.6, 0.0), np.uint8)
    # The ends over all lines: a match is judged by where it ends.
    for i in np.concatenate([np.flatnonzero(~good), np.flatnonzero(good)]):
        color = colors[i] if good[i] else OUTLIER
        for x, y in (first[i], second[i]):
            circle(picture, x, y, 3.0, DARK, -1)
            circle(picture, x, y, 2.0, color, -1)
    return picture


def panel_size(height: int, width: int) -> tuple[tuple[int, int], float]:
    """(height, width) of an image in its panel, a large one shrunk, a tiny one a whole multiple; and the factor."""
    longest = max(height, width)
    factor = min(1.0, PANEL / longest) if longest * 2 > 400 else float(400 // longest)
    return (max(1, round(height * factor)), max(1, round(width * factor))), factor


def fitted(picture: Picture) -> tuple[Picture, float]:
    """The picture as large as its panel, and the factor."""
    (height, width), factor = panel_size(picture.shape[0], picture.shape[1])
    size = (width, height)
    method = cv2.INTER_AREA if factor <= 1.0 else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(picture, size, interpolation=method), np.uint8), factor


def _dimmed(picture: Picture, factor: float) -> Picture:
    """Greyed and darkened, so that colours stand out."""
    gray = cv2.convertScaleAbs(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), alpha=factor)
    return np.asarray(cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR), np.uint8)


def _unit(picture: Picture) -> float:
    """Lengths grow with pictures beyond 800 pixels, so that rings stay visible."""
    height, width = picture.shape[:2]
    return float(max(1.0, height / 800, width / 800))
