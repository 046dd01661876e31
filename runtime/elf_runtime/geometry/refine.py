"""Places of matches, refined by comparing the two images around them."""

from __future__ import annotations

import numpy as np

from elf_runtime.contract import InputSpec
from elf_runtime.errors import ImageError, SettingError
from elf_runtime.image.convert import to_pixels
from elf_runtime.image.file import ImageLike, image_errors, read
from elf_runtime.results.features import Array, Features
from elf_runtime.results.matches import Matches, checked_matches
from elf_runtime.values import is_int, is_number

from .alignment import UPRIGHT, Squares

_GRAY = InputSpec(color="gray", channels=1)
_MOST_PIXELS = 32766  # of a side, that OpenCV's remap takes
_BAND = 64  # matches that are aligned at once: what they need stays in a processor's cache


def refine(
    matches: Matches,
    a: Features,
    b: Features,
    image_a: ImageLike,
    image_b: ImageLike,
    *,
    window: int = 31,
    max_move: float = 6.0,
    min_correlation: float = 0.8,
) -> Array:
    """Where the matched points of `a` are in the second image, to a fraction of a pixel.

    Least-squares matching (`alignment.Squares`): an affine map from the square around the first image's point to the
    second image is sought under which the two patches, each less the plane that fits it and at unit contrast, differ
    least.  The search starts at the match, with the turn and the zoom that the features' angles and sizes tell where
    the patches are more alike with them than without.  So it follows light, a change of view and, with `oriented`
    features, turns and zooms.  A match moves only if both of these hold, and stays where it is otherwise:

    - the place found is inside the image and less than `max_move` away;
    - the correlation of the patches is higher than before, and above `min_correlation`.

    Parameters
    ----------
    matches : Matches
    a, b : Features
        Of the two images.
    image_a, image_b : arrays or paths
        As `ElfRuntime.detect` takes them; of the sizes that the features say.
    window : int
        Odd number of pixels, 5 to 101: side of the square of the first image that is aligned.
    max_move : float
        Pixels of the second image, above 0.
    min_correlation : float in [-1, 1]
        Normalised cross-correlation of the aligned patches.

    Returns
    -------
    (K, 2) float32
        (x, y) in pixels of the second image; the first image's points stay as they are (`Matches.points`).

    Raises
    ------
    ImageError
        If an image can't be read or processed, is not of its features' size, or has a side above 32766 pixels.
    SettingError
        If a setting is out of range, or `matches` are none.
    """
    checked_matches(matches)
    if not (is_int(window) and 5 <= window <= 101 and window % 2 == 1):
        raise SettingError(f"window is an odd number of pixels from 5 to 101, not {window!r}")
    if not (is_number(max_move) and max_move > 0):
        raise SettingError(f"max_move is a number of pixels above 0, not {max_move!r}")
    if not (is_number(min_correlation) and -1.0 <= min_correlation <= 1.0):
        raise SettingError(f"min_correlation is a number in [-1, 1], not {min_correlation!r}")
    start, before = matches.points(a, b)
    first, second = _gray(image_a, a, "first"), _gray(image_b, b, "second")
    told, refined = _told(matches, a, b), before.copy()
    for band in (slice(i, i + _BAND) for i in range(0, len(matches), _BAND)):
        squares = Squares(first, start[band], int(window))
        places, shapes = before[band], np.tile(UPRIGHT, (len(start[band]), 1, 1))
        upright, turned = (squares.correlation(second, places, each) for each in (shapes, told[band]))
        shapes = np.where((turned > upright)[:, None, None], told[band], shapes)
        found, shapes = squares.aligned(second, places, shapes)
        after = squares.correlation(second, found, shapes)
        better = (after > np.maximum(upright, turned)) & (after > min_correlation)
        inside = ((found > -0.5) & (found < np.subtract(second.shape[::-1], 0.5))).all(axis=1)
        moves = better & inside & (np.linalg.norm(found - places, axis=1) < max_move)
        refined[band] = np.where(moves[:, None], found, places)
    return refined


def _gray(image: ImageLike, features: Features, which: str) -> Array:
    """(H, W) float32."""
    with image_errors(image, f"the {which} image"):
        gray = to_pixels(read(image), _GRAY)[:, :, 0]
    if gray.shape != tuple(features.image_size):
        (height, width), (h, w) = gray.shape, features.image_size
        raise ImageError(f"the {which} image has {width}x{height} pixels, but its features are of one of {w}x{h}")
    if max(gray.shape) > _MOST_PIXELS:
        raise ImageError(f"the {which} image has a side above {_MOST_PIXELS} pixels; matches can't be refined by it")
    return gray


def _told(matches: Matches, a: Features, b: Features) -> Array:
    """(K, 2, 2): the turn and the zoom from the first image to the second that the features' angles and sizes tell."""
    i, j = matches.indices.T
    zoom = b.sizes[j] / a.sizes[i]
    turn = np.where((a.angles[i] >= 0) & (b.angles[j] >= 0), np.radians(b.angles[j] - a.angles[i]), 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        cos, sin = zoom * np.cos(turn), zoom * np.sin(turn)
    return np.stack([cos, -sin, sin, cos], axis=1).reshape(-1, 2, 2).astype(np.float32)
