"""The pictures that graphs are checked on, and what a graph does to their pixels in float64 numpy."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from elf_export.preprocessing import LEAST_STD, Preprocessing, conversion

Array = npt.NDArray[np.float32]


def probe_images(height: int, width: int, channels: int) -> list[tuple[str, Array]]:
    """A cartoon (edges and corners on a fine grain, flat areas with exact ties) and noise.

    The grain keeps straight edges from giving rows of equal scores, where rounding would pick the keypoint.

    Returns
    -------
    list of (name, (height, width, channels) float32 holding integers in 0..255)
    """
    rng = np.random.default_rng(7)
    y, x = np.mgrid[:height, :width]
    cartoon = np.empty((height, width, channels), np.float32)
    cartoon[:] = 90 + 60 * np.sin(x / 37)[..., None] * np.cos(y / 23)[..., None]
    grain = rng.integers(-6, 7, cartoon.shape)
    for index in range(60):
        top, left = rng.integers(0, height - 8), rng.integers(0, width - 8)
        h, w = rng.integers(6, height // 4), rng.integers(6, width // 4)
        cartoon[top : top + h, left : left + w] = rng.integers(6, 250, channels)
        if index % 4 == 0:
            grain[top : top + h, left : left + w] = 0
    noise = rng.integers(0, 256, (height, width, channels))
    cartoon = np.floor(cartoon + grain).clip(0, 255)
    return [("cartoon", cartoon.astype(np.float32)), ("noise", noise.astype(np.float32))]


def grainy(height: int, width: int, channels: int, seed: int) -> Array:
    """A picture without ties: (H, W, C) float32 between 0 and 255, waves and edges under a fine grain.

    Where two pixels of a pooling window are equal the derivative does not exist, and no two steps would agree; nor does
    it at 0 and 255, where a network may cut its pixels off.
    """
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    picture = np.zeros((height, width, channels))
    for _ in range(12):
        fy, fx, phase = rng.normal(0, 0.25), rng.normal(0, 0.25), rng.uniform(0, 2 * np.pi)
        wave = np.sin(fy * y + fx * x + phase)
        picture += (np.sign(wave) if rng.random() < 0.5 else wave)[..., None] * rng.uniform(0.2, 1, channels)
    picture += 0.3 * rng.standard_normal(picture.shape)
    low, high = picture.min(), picture.max()
    return np.asarray(1 + 253 * (picture - low) / (high - low), np.float32)


def preprocess(
    pixels: npt.NDArray[np.floating], settings: Preprocessing, color: str | None = None, layout: str = "NCHW"
) -> npt.NDArray[np.float64]:
    """What the graph does to raw pixels of colour order `color`, in float64 numpy: (N, H, W, C) -> `layout`."""
    x = np.asarray(pixels, np.float64)
    if color not in (None, settings.color):
        x = x @ conversion(color, settings.color)
    if settings.standardize:
        x = x - x.mean(axis=(1, 2, 3), keepdims=True)
        x = x / np.maximum(np.sqrt((x * x).mean(axis=(1, 2, 3), keepdims=True)), LEAST_STD)
    else:
        x = (x * settings.scale - np.asarray(settings.mean)) / np.asarray(settings.std)
    # A copy, always: the strides that one channel's view keeps pass for channels last, where torch may round by place,
    # and flat areas lose their ties.
    return np.array(x.transpose(["NHWC".index(axis) for axis in layout]), np.float64, order="C")
