"""Presets: detection settings under a name."""

from __future__ import annotations

from dataclasses import replace

from .errors import SettingError, suggestion
from .params import DetectionParams

_PAPER = DetectionParams(quantize=True, min_contrast=0.0)

# The paper's table of (denoise, threshold) blurs; a network that is not in it gets VGG's.
_PAPER_BY_NETWORK: dict[str, DetectionParams] = {
    "xception": replace(_PAPER, denoise=(9, 3.0)),
    "superpoint": replace(_PAPER, denoise=(7, 2.0), threshold_blur=(17, 6.0)),
    "sobel": replace(_PAPER, denoise=(9, 9.0)),
    "laplacian": replace(_PAPER, denoise=(9, 9.0)),
}

# Measured with the bundled model (figures: docs/quality.md).  Windows of 5x5 working pixels, 7x7 where these are small.
# The border keeps out what the network's zero padding makes of plain coloured ground.
DEFAULT = DetectionParams(
    denoise=(5, 1.2), normalize=0.95, nms_radius=5, suppression="maxima", border=14, scale=0.45, subpixel=True
)
_OURS: dict[str, DetectionParams] = {
    "fast": replace(DEFAULT, scale=0.33, denoise=(3, 0.8), border=20, min_contrast=1.0),
    "default": DEFAULT,
    "accurate": replace(DEFAULT, scale=1.0, denoise=(3, 0.8), nms_radius=3, border=12),
    "multiscale": replace(DEFAULT, scales=(0.25, 0.5, 1.0), denoise=(3, 0.8), nms_radius=3),
}

PRESETS: tuple[str, ...] = (*_OURS, "paper", "paper-webcam", "paper-robust", "paper-components")


def preset(name: str, network: str = "vgg") -> DetectionParams:
    """The named settings.

    ``fast``, ``default`` and ``accurate`` are this project's, for its bundled model, at working scales of 0.33, 0.45
    and 1: a larger one places keypoints better.  ``multiscale`` detects at 0.25, 0.5 and 1.

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
    raise SettingError(f"unknown preset {name!r}; known are {list(PRESETS)}{suggestion(name, PRESETS)}")
