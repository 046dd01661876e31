"""Image gradients in a network's place: the paper's baseline (section 4.4), as graphs of the same shape.

The saliency is the layer itself, no derivative of it: the magnitude of the 3x3 Sobel gradient, or the
absolute 11x11 Laplacian, of the grey image, its border mirrored (OpenCV's definitions).  The paper gives no size of
the kernels; a 3x3 Laplacian answers to single pixels, which the paper's blur of 9x9 washes out.
"""

from __future__ import annotations

from dataclasses import replace
from math import comb

import torch
from torch.nn import functional as F

from elf_export.preprocessing import Preprocessing
from elf_export.sources.weights.fit import fit_named

from .architecture import Architecture, Maps, Part
from .registry import Network

GREY = (0.114, 0.587, 0.299)  # of B, G, R: ITU-R BT.601
SOBEL_X = ((-1.0, 0.0, 1.0), (-2.0, 0.0, 2.0), (-1.0, 0.0, 1.0))
LAPLACE_SIZE = 11


def laplace(size: int) -> torch.Tensor:
    """(size, size): s d^T + d s^T, with s the binomial of `size`, and d that of `size` - 2 differentiated twice.

    s_k = C(size - 1, k),  d_k = b_k - 2 b_(k-1) + b_(k-2) with b_k = C(size - 3, k)
    """
    s = [comb(size - 1, k) for k in range(size)]
    b = [0, 0, *(comb(size - 3, k) for k in range(size - 2)), 0, 0]
    d = [b[k + 2] - 2 * b[k + 1] + b[k] for k in range(size)]
    # In plain numbers: traced, operations on tensors would become nodes of the graph.
    return torch.tensor([[float(s[i] * d[j] + d[i] * s[j]) for j in range(size)] for i in range(size)])


def _filtered(x: torch.Tensor, kernel: torch.Tensor) -> torch.Tensor:
    grey = F.conv2d(x, torch.tensor(GREY, dtype=x.dtype, device=x.device).view(1, 3, 1, 1))
    return F.conv2d(F.pad(grey, (len(kernel) // 2,) * 4, mode="reflect"), kernel.to(x)[None, None])


def sobel(part: Part, x: torch.Tensor) -> Maps:
    """sqrt(gx^2 + gy^2)"""
    del part
    kernel = torch.tensor(SOBEL_X)
    gx, gy = _filtered(x, kernel), _filtered(x, kernel.T.contiguous())
    yield "magnitude", torch.sqrt(gx * gx + gy * gy)


def laplacian(part: Part, x: torch.Tensor) -> Maps:
    """|gxx + gyy|"""
    del part
    yield "magnitude", torch.abs(_filtered(x, laplace(LAPLACE_SIZE)))


_SOBEL, _LAPLACIAN = Architecture({}, sobel), Architecture({}, laplacian)

SOBEL = Network(
    name="sobel",
    title="Magnitude of the image's Sobel gradient, no network",
    layers=_SOBEL.layers,
    default_layer="magnitude",
    default_descriptors=("vgg:pool4",),
    build=_SOBEL.build,
    tensor_shapes=_SOBEL.tensor_shapes,
    fit=fit_named,
    source_title="none needed",
    licence="",
    preprocessing=Preprocessing(color="bgr", standardize=False),
    gradient=False,
)

LAPLACIAN = replace(
    SOBEL,
    name="laplacian",
    title="Absolute Laplacian of the image, no network",
    layers=_LAPLACIAN.layers,
    build=_LAPLACIAN.build,
    tensor_shapes=_LAPLACIAN.tensor_shapes,
)
