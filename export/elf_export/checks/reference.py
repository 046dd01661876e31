"""The saliency by torch.autograd: the reference that an exported network is held against."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from elf_export.preprocessing import LEAST_STD, Preprocessing, conversion

if TYPE_CHECKING:
    import torch

    from .autograd import Array, Reference
    from .projection import Maps


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


def torch_saliency(
    module: torch.nn.Module,
    settings: Preprocessing,
    dtype: str = "float64",
    differentiate: bool = True,
    color: str | None = None,
) -> Reference:
    """``f(pixels)``: |gradient of 1/2 ||F||^2 w.r.t. the preprocessed image|, averaged over its channels.

    Parameters
    ----------
    module : torch.nn.Module
        Its forward returns the maps of the wanted layers, F first.  It is converted to `dtype` in place.
    differentiate : bool
        False: F itself in the gradient's place.
    color : str, optional
        Colour order of the pixels, if it is not that of `settings`.
    """
    import torch

    kind = getattr(torch, dtype)
    module = module.to(kind)

    def saliency(pixels: Array) -> npt.NDArray[np.float64]:
        x = torch.from_numpy(preprocess(pixels, settings, color)).to(kind).requires_grad_(True)
        f = module(x)[0]
        (gradient,) = torch.autograd.grad(f, x, f.detach()) if differentiate else (f.detach(),)
        return np.asarray(gradient.abs().mean(1).double().numpy())

    return saliency


def torch_maps(
    module: torch.nn.Module, layers: Sequence[str], settings: Preprocessing, color: str | None = None
) -> Maps:
    """``f(pixels)``: the maps that a module's forward returns, by the names in `layers`, in float64, channels last.

    The module is converted to float64 in place.
    """
    import torch

    module = module.double()

    def maps(pixels: Array) -> dict[str, npt.NDArray[np.float64]]:
        with torch.no_grad():
            found = module(torch.from_numpy(preprocess(pixels, settings, color)))
        return {name: one.permute(0, 2, 3, 1).numpy() for name, one in zip(layers, found, strict=True)}

    return maps
