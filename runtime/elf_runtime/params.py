"""Detection settings: what they mean, which values they take, and how they are written as text.

Blurs are ``(mu, sigma)``: a ``mu x mu`` Gaussian window (mu odd) of standard deviation sigma, as in the
paper's tables, in pixels of the working image: the source image times `scale`.  `nms_radius` and `border` are
in pixels of the source image, whatever the scale; `max_keypoints` counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from .errors import SettingError, suggestion
from .values import (
    MOST_SCALES,
    WIDEST_BLUR,
    Blur,
    Checked,
    blur,
    boolean,
    grid,
    integer,
    number,
    positive,
    scales,
    word,
)


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
    suppression : "greedy" or "maxima"
        "greedy", the paper's: the strongest pixel is taken, its window struck out, and so on; where a window ends, the
        slope that goes on behind it may give a further keypoint.  "maxima": of these, only pixels whose score nothing
        in their window exceeds, so that each keypoint has a place of its own.
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
    scales : tuple of float, or "none"
        Several working scales, at most 5, in place of `scale`: keypoints are sought at each, as if it were the only
        one, and a keypoint suppresses weaker ones of the other scales too.  Each scale has a share of `max_keypoints`
        in proportion to it; what it can't fill goes to the strongest left over.  "none", the empty tuple, is `scale`.
    max_side : "none" or int
        Longest side of the working image, in pixels: where an image is larger at `scale`, or at the largest of
        `scales`, it is seen at smaller ones, all by the same factor.  Time and memory of the network end there.
    oriented : bool
        Give each keypoint an orientation and a size of its own, and describe what is around it turned upright and
        brought to that size: for images that are turned in their plane, and with several `scales` of different zoom.
        With `subpixel` it lies in the middle of what it is on (see `scale_space`).  The network then looks at a patch
        for each keypoint (see `upright`), which takes most of the time unless images are large.  Not for a model of one
        size only.
    quantize : bool
        Round the normalised saliency to 8 bits before the blurs, as the paper does.
    normalize : float
        The level is chosen from the saliency divided by this quantile of itself and cut off at 1: 1.0 divides by
        the maximum, as the paper does; 0.95 keeps one outlier from squashing the histogram.
    subpixel : bool
        Place each keypoint at the top of a quadratic surface through its score and those around it.
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
    scales: tuple[float, ...] = ()
    suppression: str = "greedy"
    oriented: bool = False
    max_side: str | int = "none"

    def __post_init__(self) -> None:
        for name in _RULES:
            object.__setattr__(self, name, _checked(name, getattr(self, name)))

    @property
    def working_scales(self) -> tuple[float, ...]:
        """The working scales in use, the finest first."""
        return self.scales[::-1] or (self.scale,)

    def scales_for(self, size: tuple[int, int]) -> tuple[float, ...]:
        """`working_scales` for an image of (height, width), all smaller where `max_side` asks for it."""
        if isinstance(self.max_side, str):
            return self.working_scales
        factor = self.max_side / (self.working_scales[0] * max(size))
        return tuple(scale * min(1.0, factor) for scale in self.working_scales)

    def updated(self, /, **changes: Any) -> DetectionParams:
        """A copy with the settings that are not None replaced; a new `scale` without `scales` is the only one.

        Raises
        ------
        SettingError
            On an unknown name or a value out of range.
        """
        for name in changes:
            _check_name(name)
        given = {name: value for name, value in changes.items() if value is not None}
        if "scale" in given:
            given.setdefault("scales", ())
        return replace(self, **given)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> DetectionParams:
        """Inverse of `to_dict`; an unknown key is an error."""
        return cls().updated(**data)


def parse_setting(text: str) -> tuple[str, Any]:
    """A setting's name and value: "scale=0.5", "denoise=5,1.2", "subpixel=true", "threshold=kapur".

    The name may be any: `DetectionParams` knows which there are, and which values they take.

    Raises
    ------
    SettingError
        If the text is not ``NAME=VALUE``.
    """
    name, equals, value = text.partition("=")
    if not equals or not name or not all(map(str.strip, value.split(","))):
        raise SettingError(f"{text!r} is not NAME=VALUE")
    return name.strip(), parse_value(value)


def parse_value(text: str) -> Any:
    """A number, true or false, a word, or, between commas, several of them: what the text of a setting stands for."""
    parts = [_parse_part(part.strip()) for part in text.split(",")]
    return parts[0] if len(parts) == 1 else tuple(parts)


def setting_value(name: str, text: str) -> Any:
    """`parse_value` for the setting of that name, whose errors show several values as they are in the text.

    Raises
    ------
    SettingError
        If there is no such setting, or it can't have this value.
    """
    _check_name(name)
    value = parse_value(text)
    return _checked(name, value, text if isinstance(value, tuple) else "")


def _check_name(name: str) -> None:
    if name not in SETTINGS:
        raise SettingError(
            f"unknown detection setting {name!r}; known are {sorted(SETTINGS)}{suggestion(name, SETTINGS)}"
        )


def _checked(name: str, value: Any, shown: str = "") -> Any:
    """A setting's value as Python's own type; `shown` stands for it in the error."""
    expected, checked = _RULES[name]
    if (found := checked(value)) is None:
        raise SettingError(f"{name} is {expected}, not {shown or repr(value)}")
    return found


def setting_text(value: Any) -> str:
    """A setting's value as `parse_setting` reads it."""
    if isinstance(value, tuple):
        return ",".join(map(setting_text, value)) or "none"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _parse_part(text: str) -> Any:
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text


_BLUR = (f"(mu, sigma) with mu odd, 1 to {WIDEST_BLUR}, and sigma > 0", blur)
_COUNT = ("an integer >= 0", integer)
_FLAG = ("True or False", boolean)

# Setting -> what it is, in words, and the check that says so.
_RULES: Mapping[str, tuple[str, Checked]] = {
    "denoise": _BLUR,
    "threshold_blur": _BLUR,
    "threshold": ("'kapur', 'none' or a number in [0, 1]", word(("kapur", "none"), number(1.0))),
    "nms_radius": _COUNT,
    "border": _COUNT,
    "max_keypoints": _COUNT,
    "scale": ("a number in (0, 8]", number(8.0, above=0.0)),
    "quantize": _FLAG,
    "normalize": ("a quantile in (0, 1]", number(1.0, above=0.0)),
    "subpixel": _FLAG,
    "mask_border": ("'auto' or an integer >= 0", word(("auto",), integer)),
    "min_contrast": ("a number of grey levels in [0, 255]", number(255.0)),
    "grid": ("(rows, columns), integers >= 1", grid),
    "oriented": _FLAG,
    "scales": (f"'none' or up to {MOST_SCALES} different numbers in (0, 8]", scales),
    "max_side": ("'none' or an integer >= 1", word(("none",), positive)),
    "suppression": ("'greedy' or 'maxima'", word(("greedy", "maxima"), lambda _: None)),
}
SETTINGS: tuple[str, ...] = tuple(_RULES)
"""The names of all settings."""
