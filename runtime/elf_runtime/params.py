"""Detection settings, and the presets that name the useful ones.

Blurs are ``(mu, sigma)``: a ``mu x mu`` Gaussian window (mu odd) of standard deviation sigma, as in the
paper's tables, in pixels of the working image: the source image times `scale`.  `nms_radius` and `border` are
in pixels of the source image, whatever the scale; `max_keypoints` counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from .errors import SettingError

Blur = tuple[int, float]


WIDEST_BLUR = 999  # pixels; wider ones leave nothing of an image


@dataclass(frozen=True)
class DetectionParams:
    """Settings of threshold, denoising and non-maximum suppression.

    Attributes
    ----------
    denoise, threshold_blur : (mu, sigma)
        Gaussian blur of the saliency before the maxima are sought, and before the level is chosen.
        ``mu = 1`` is no blur.
    threshold : "kapur", "none" or float
        Kapur's maximum-entropy level, no threshold, or a fixed level as a fraction of the normalised saliency.
    nms_radius : int
        A keypoint suppresses all weaker ones in a square window around its working pixel.  The window reaches so many
        source pixels to each side, rounded to the nearest working pixel (at least one, where above 0); sub-pixel
        places may then be up to a working pixel nearer to each other.
    border : int
        Source pixels along each edge where no keypoint is taken: x and y are at least `border`, and at most
        ``size - 1 - border``.
    mask_border : "auto" or int
        Source pixels along the edge of a mask, or of what alpha leaves of an image, where no keypoint is taken.  "auto"
        is as far as the network sees that edge: half its receptive field and half the `denoise` window, at the working
        scale; `border` for a model that does not say what it sees.  0 for a mask that cuts through real scenery (an
        object that moves, say): there is nothing wrong with its edge.
    min_contrast : float
        No keypoint where the image has less contrast than that many grey levels of 255: the standard deviation around
        it of what a fitted plane leaves (see `contrast.contrast_map`), over the window that a cell of the network sees,
        at least 11x11 working pixels.  All other levels are relative: without this one, a blank wall gives as many
        keypoints as a photograph.  uint16 images have the fewest bits, 8 or more, that hold their largest value.
    grid : (rows, columns)
        Spread the keypoints: each cell of the image has a level of its own and an equal share of `max_keypoints`; what
        a cell can't fill goes to the strongest left over.  (1, 1) takes the strongest wherever they are.
    max_keypoints : int
        The strongest that many are kept.
    scale : float
        Working scale: the image is resized by it before the network sees it (0.5 = half width and height).
    quantize : bool
        Round the normalised saliency to 8 bits before the blurs, as the paper does.
    normalize : float
        The level is chosen from the saliency divided by this quantile of itself and cut off at 1: 1.0 divides by
        the maximum, as the paper does; 0.95 keeps one outlier from squashing the histogram.
    subpixel : bool
        Place each keypoint at the top of a parabola through its score and its neighbours', along x and y.
    """

    denoise: Blur = (5, 5.0)
    threshold_blur: Blur = (5, 4.0)
    threshold: str | float = "kapur"
    nms_radius: int = 10
    border: int = 10
    max_keypoints: int = 500
    scale: float = 1.0
    quantize: bool = False
    normalize: float = 1.0
    subpixel: bool = False
    mask_border: str | int = "auto"
    min_contrast: float = 1.5
    grid: tuple[int, int] = (1, 1)

    def __post_init__(self) -> None:
        for name in ("denoise", "threshold_blur"):
            blur = getattr(self, name)
            ok = isinstance(blur, (tuple, list)) and len(blur) == 2 and is_int(blur[0]) and is_number(blur[1])
            if not ok or not 1 <= blur[0] <= WIDEST_BLUR or blur[0] % 2 == 0 or not 0 < blur[1] < float("inf"):
                raise SettingError(
                    f"{name} is (mu, sigma) with mu odd, 1 to {WIDEST_BLUR}, and sigma > 0, not {blur!r}"
                )
            object.__setattr__(self, name, (int(blur[0]), float(blur[1])))
        if isinstance(self.threshold, str):
            if self.threshold not in ("kapur", "none"):
                raise SettingError(f"threshold is 'kapur', 'none' or a number in [0, 1], not {self.threshold!r}")
        elif not is_number(self.threshold) or not 0.0 <= self.threshold <= 1.0:
            raise SettingError(f"threshold is 'kapur', 'none' or a number in [0, 1], not {self.threshold!r}")
        for name, least in (("nms_radius", 0), ("border", 0), ("max_keypoints", 0)):
            value = getattr(self, name)
            if not is_int(value) or value < least:
                raise SettingError(f"{name} is an integer >= {least}, not {value!r}")
            object.__setattr__(self, name, int(value))
        if not is_number(self.scale) or not 0.0 < self.scale <= 8.0:
            raise SettingError(f"scale is a number in (0, 8], not {self.scale!r}")
        if not is_number(self.normalize) or not 0.0 < self.normalize <= 1.0:
            raise SettingError(f"normalize is a quantile in (0, 1], not {self.normalize!r}")
        if not is_number(self.min_contrast) or not 0.0 <= self.min_contrast <= 255.0:
            raise SettingError(f"min_contrast is a number of grey levels in [0, 255], not {self.min_contrast!r}")
        near = self.mask_border
        if not (near == "auto" if isinstance(near, str) else is_int(near) and near >= 0):
            raise SettingError(f"mask_border is 'auto' or an integer >= 0, not {self.mask_border!r}")
        grid = self.grid
        if not (isinstance(grid, (tuple, list)) and len(grid) == 2 and all(is_int(n) and n >= 1 for n in grid)):
            raise SettingError(f"grid is (rows, columns), integers >= 1, not {grid!r}")
        object.__setattr__(self, "grid", (int(grid[0]), int(grid[1])))
        object.__setattr__(self, "mask_border", near if isinstance(near, str) else int(near))
        for name in ("threshold", "scale", "normalize", "min_contrast"):
            value = getattr(self, name)
            object.__setattr__(self, name, str(value) if isinstance(value, str) else float(value))
        for name in ("quantize", "subpixel"):
            if not isinstance(getattr(self, name), bool):
                raise SettingError(f"{name} is True or False, not {getattr(self, name)!r}")

    def updated(self, **changes: Any) -> DetectionParams:
        """A copy with the settings that are not None replaced.

        Raises
        ------
        SettingError
            On an unknown name or a value out of range.
        """
        known = {f.name for f in fields(self)}
        for name in changes:
            if name not in known:
                raise SettingError(f"unknown detection setting {name!r}; known are {sorted(known)}")
        return replace(self, **{name: value for name, value in changes.items() if value is not None})

    def to_dict(self) -> dict[str, Any]:
        """Plain data, for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> DetectionParams:
        """Inverse of `to_dict`; an unknown key is an error."""
        return cls().updated(**data)


def is_int(value: object) -> bool:
    """Whether it is an integer, of Python or of numpy, and not a bool."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def is_number(value: object) -> bool:
    """Whether it is an integer as `is_int` says, or a float, of Python or of numpy."""
    return is_int(value) or isinstance(value, (float, np.floating))


_PAPER = DetectionParams(quantize=True, min_contrast=0.0)

# The paper's table of (denoise, threshold) blurs; a network that is not in it gets VGG's.
_PAPER_BY_NETWORK: dict[str, DetectionParams] = {
    "xception": replace(_PAPER, denoise=(9, 3.0)),
    "superpoint": replace(_PAPER, denoise=(7, 2.0), threshold_blur=(17, 6.0)),
    "sobel": replace(_PAPER, denoise=(9, 9.0)),
    "laplacian": replace(_PAPER, denoise=(9, 9.0)),
}

# Measured with the bundled model (README.md has the figures).  The blur grows with the working scale: it spans the
# same part of the scene.  The border keeps out what the network's zero padding makes of plain coloured ground.
DEFAULT = DetectionParams(denoise=(5, 1.2), normalize=0.95, nms_radius=6, border=14, scale=0.45, subpixel=True)
_OURS: dict[str, DetectionParams] = {
    "fast": replace(DEFAULT, scale=0.28, denoise=(3, 0.8), border=20, min_contrast=1.0),
    "default": DEFAULT,
    "accurate": replace(DEFAULT, scale=0.75, denoise=(7, 1.8), border=12),
}

PRESETS: tuple[str, ...] = (*_OURS, "paper", "paper-webcam", "paper-robust", "paper-components")


def preset(name: str, network: str = "vgg") -> DetectionParams:
    """The named settings.

    ``fast``, ``default`` and ``accurate`` are this project's, for its bundled model, at working scales of 0.28, 0.45
    and 0.75: a larger one places keypoints better.

    The others are the paper's for `network`, at full resolution, with its 8-bit saliency: ``paper`` is the generic
    setting (HPatches), ``paper-webcam`` the one of the Webcam runs, ``paper-robust`` that of the rotation, scale and
    3D-viewpoint runs, ``paper-components`` that of the runs where a detector or a descriptor is compared alone.

    Raises
    ------
    SettingError
        If there is no such preset.
    """
    if isinstance(name, str) and name in _OURS:
        return _OURS[name]
    params = _PAPER_BY_NETWORK.get(network, _PAPER)
    if name == "paper":
        return params
    if name == "paper-webcam":
        return replace(params, denoise=(9, 9.0)) if network == "xception" else params
    if name == "paper-robust":
        return replace(_PAPER, denoise=(5, 2.0), threshold_blur=(17, 6.0))
    if name == "paper-components":
        return replace(params, threshold_blur=(5, 5.0))
    raise SettingError(f"unknown preset {name!r}; known are {list(PRESETS)}")
