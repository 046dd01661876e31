"""Places of matches, refined by comparing the two images around them."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.contract import InputSpec
from elf_runtime.errors import ImageError, SettingError
from elf_runtime.image.convert import to_pixels, unused_range
from elf_runtime.image.file import ImageLike, image_errors, read
from elf_runtime.results.features import Array, Features
from elf_runtime.results.matches import Matches
from elf_runtime.values import is_int, is_number

_GRAY = InputSpec(color="gray", channels=1)
_SPREAD = 8.0  # pixels: sigma of the Gaussian over which brightness and contrast are evened out
_NOISE = 1.0  # grey levels of 255: contrast far below it is not stretched
_ROUND_TRIP = 0.5  # pixels between a point and where it comes back to from the other image
_MARGIN = 3  # pixels that the compared patch reaches beyond the window on each side
_BAND = 8192  # points whose patches are compared at once; OpenCV's remap takes at most 32767 rows


def refine(
    matches: Matches,
    a: Features,
    b: Features,
    image_a: ImageLike,
    image_b: ImageLike,
    *,
    window: int = 13,
    max_move: float = 6.0,
    min_correlation: float = 0.8,
) -> Array:
    """Where the matched points of `a` are in the second image, to a fraction of a pixel.

    The method of Lucas and Kanade ("An iterative image registration technique with an application to stereo vision",
    IJCAI 1981), as OpenCV's pyramids have it, at full size, started at the match.  It runs on images whose brightness
    and contrast are evened out locally, so a change of light does no harm.  It can't follow a turn or a change of
    scale.  So a match moves only if all of these hold, and stays where it is otherwise:

    - the place found is less than `max_move` away;
    - from there the same search leads back to the first image's point, within half a pixel;
    - the correlation of the patches around the two places is higher than before, and above `min_correlation`.

    Parameters
    ----------
    matches : Matches
    a, b : Features
        Of the two images.
    image_a, image_b : arrays or paths
        As `ElfRuntime.detect` takes them; of the sizes that the features say.
    window : int
        Odd number of pixels, 5 or more: side of the square that is aligned.  Patches are compared over six more.
    max_move : float
        Pixels of the second image, above 0.
    min_correlation : float in [-1, 1]
        Normalised cross-correlation of the evened-out patches.

    Returns
    -------
    (K, 2) float32
        (x, y) in pixels of the second image; the first image's points stay as they are (`Matches.points`).

    Raises
    ------
    ImageError
        If an image can't be read or processed, or is not of its features' size.
    SettingError
        If a setting is out of range.
    """
    if not (is_int(window) and window >= 5 and window % 2 == 1):
        raise SettingError(f"window is an odd number of pixels from 5 on, not {window!r}")
    if not (is_number(max_move) and max_move > 0):
        raise SettingError(f"max_move is a number of pixels above 0, not {max_move!r}")
    if not (is_number(min_correlation) and -1.0 <= min_correlation <= 1.0):
        raise SettingError(f"min_correlation is a number in [-1, 1], not {min_correlation!r}")
    start, before = matches.points(a, b)
    first, second = _of_one_size(_evened(image_a, a, "first"), _evened(image_b, b, "second"))
    if not len(matches):
        return before
    after, found = _followed(first, second, start, before, window)
    back, returned = _followed(second, first, after, start, window)
    patches = _patches(first, start, window + 2 * _MARGIN)
    old, new = (_correlation(patches, _patches(second, places, window + 2 * _MARGIN)) for places in (before, after))
    better = (new > old) & (new > min_correlation)
    near = np.linalg.norm(after - before, axis=1) < max_move
    same = np.linalg.norm(back - start, axis=1) < _ROUND_TRIP
    return np.where((found & returned & better & near & same)[:, None], after, before).astype(np.float32)


def _evened(image: ImageLike, features: Features, which: str) -> npt.NDArray[np.uint8]:
    """(H, W) uint8: grey, less its local mean, over its local contrast; what Lucas-Kanade in OpenCV takes."""
    with image_errors(image, f"the {which} image"):
        pixels = read(image)
        gray = to_pixels(pixels, _GRAY)[:, :, 0] * np.float32(unused_range(pixels))
    if gray.shape != tuple(features.image_size):
        (height, width), (h, w) = gray.shape, features.image_size
        raise ImageError(f"the {which} image has {width}x{height} pixels, but its features are of one of {w}x{h}")
    mean = cv2.GaussianBlur(gray, (0, 0), _SPREAD)
    variance = np.maximum(cv2.GaussianBlur(gray * gray, (0, 0), _SPREAD) - mean * mean, 0.0)
    even = (gray - mean) / np.sqrt(variance + _NOISE**2)
    # 3 standard deviations to each side.
    return np.asarray(np.rint(np.clip(127.5 + 42.5 * even, 0, 255)), np.uint8)


def _of_one_size(*images: npt.NDArray[np.uint8]) -> list[npt.NDArray[np.uint8]]:
    """Continued by their edges to the right and below, as OpenCV's Lucas-Kanade takes images of one size only."""
    height, width = np.max([image.shape for image in images], axis=0)
    missing = ((0, height - image.shape[0], 0, width - image.shape[1]) for image in images)
    return [
        np.asarray(cv2.copyMakeBorder(image, *sides, cv2.BORDER_REPLICATE), np.uint8)
        for image, sides in zip(images, missing, strict=True)
    ]


def _followed(
    source: npt.NDArray[np.uint8], target: npt.NDArray[np.uint8], points: Array, guess: Array, window: int
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Where the (K, 2) `points` of `source` are in `target`, sought from `guess` on, and which of them were found."""
    places, status, _ = cv2.calcOpticalFlowPyrLK(
        source,
        target,
        points.reshape(-1, 1, 2).astype(np.float32),
        guess.reshape(-1, 1, 2).astype(np.float32),  # a copy, which OpenCV writes to
        winSize=(window, window),
        maxLevel=0,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.01),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    places = np.asarray(places, np.float32).reshape(-1, 2)
    found = (np.asarray(status).ravel() != 0) & np.isfinite(places).all(axis=1)
    return np.where(found[:, None], places, guess).astype(np.float32), found


def _patches(image: npt.NDArray[np.uint8], points: Array, side: int) -> Array:
    """(K, side * side): the squares around points, interpolated; beyond the image its edge goes on."""
    offset = np.arange(side, dtype=np.float32) - np.float32((side - 1) / 2)
    dx, dy = np.tile(offset, side), np.repeat(offset, side)
    pixels, bands = image.astype(np.float32), range(0, len(points), _BAND)
    parts = [
        cv2.remap(pixels, x + dx, y + dy, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for x, y in ((points[i : i + _BAND, :1], points[i : i + _BAND, 1:]) for i in bands)
    ]
    return np.concatenate(parts)


def _correlation(a: Array, b: Array) -> npt.NDArray[np.float64]:
    """Normalised cross-correlation of each row of `a` with that of `b`, in [-1, 1]; 0 where one of them is flat."""
    a, b = a - a.mean(axis=1, keepdims=True), b - b.mean(axis=1, keepdims=True)
    scale = np.sqrt(np.einsum("kp,kp->k", a, a) * np.einsum("kp,kp->k", b, b))
    products = np.einsum("kp,kp->k", a, b)
    return np.asarray(np.divide(products, scale, out=np.zeros(len(a)), where=scale > 0), np.float64)
