"""A network's saliency and maps by torch, in any of its dtypes: what an exported graph is held against."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from elf_export.preprocessing import Preprocessing

from .pictures import preprocess

if TYPE_CHECKING:
    import torch

Array = npt.NDArray[np.float32]
Array64 = npt.NDArray[np.float64]

Reference = Callable[[Array], Array64]
"""(N, H, W, C) float32 raw pixels -> (N, H, W) float64 saliency."""


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

    def saliency(pixels: Array) -> Array64:
        x = torch.from_numpy(preprocess(pixels, settings, color)).to(kind).requires_grad_(True)
        f = module(x)[0]
        (gradient,) = torch.autograd.grad(f, x, f.detach()) if differentiate else (f.detach(),)
        return np.asarray(gradient.abs().mean(1).double().numpy())

    return saliency


def torch_maps(
    module: torch.nn.Module, layers: Sequence[str], settings: Preprocessing, color: str | None = None
) -> Callable[[Array], dict[str, Array64]]:
    """``f(pixels)``: the maps that a module's forward returns, by the names in `layers`, in float64, channels last.

    The module is converted to float64 in place.
    """
    import torch

    module = module.double()

    def maps(pixels: Array) -> dict[str, Array64]:
        with torch.no_grad():
            found = module(torch.from_numpy(preprocess(pixels, settings, color)))
        return {name: one.permute(0, 2, 3, 1).numpy() for name, one in zip(layers, found, strict=True)}

    return maps
