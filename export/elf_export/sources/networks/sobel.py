"""The image's Sobel gradient in a network's place: the paper's baseline (section 4.4), as a graph of the same shape.

The saliency is the layer itself and no derivative of it: the magnitude of the 3x3 Sobel gradient of the grey image, its
border mirrored (OpenCV's definitions).  The paper gives no size of the kernels.
"""

from __future__ import annotations

import torch
from torch.nn import functional as F

from elf_export.preprocessing import Preprocessing
from elf_export.sources.weights.fit import fit_named

from .parts.architecture import Architecture, Maps, Part
from .parts.network import Network

GREY = (0.114, 0.587, 0.299)  # of B, G, R: ITU-R BT.601
SOBEL_X = ((-1.0, 0.0, 1.0), (-2.0, 0.0, 2.0), (-1.0, 0.0, 1.0))


def filtered(x: torch.Tensor, kernel: torch.Tensor) -> torch.Tensor:
    """(N, 1, H, W): the grey image of (N, 3, H, W), its border mirrored, under a kernel."""
    grey = F.conv2d(x, torch.tensor(GREY, dtype=x.dtype, device=x.device).view(1, 3, 1, 1))
    return F.conv2d(F.pad(grey, (len(kernel) // 2,) * 4, mode="reflect"), kernel.to(x)[None, None])


def sobel(part: Part, x: torch.Tensor) -> Maps:
    """sqrt(gx^2 + gy^2)"""
    del part
    kernel = torch.tensor(SOBEL_X)
    gx, gy = filtered(x, kernel), filtered(x, kernel.T.contiguous())
    yield "magnitude", torch.sqrt(gx * gx + gy * gy)


_ARCHITECTURE = Architecture({}, sobel)

NETWORK = Network(
    name="sobel",
    title="Magnitude of the image's Sobel gradient, no network",
    layers=_ARCHITECTURE.layers,
    default_layer="magnitude",
    default_descriptors=("vgg:pool4",),
    build=_ARCHITECTURE.build,
    tensor_shapes=_ARCHITECTURE.tensor_shapes,
    fit=fit_named,
    source_title="none needed",
    licence="",
    preprocessing=Preprocessing(color="bgr", standardize=False),
    gradient=False,
)
