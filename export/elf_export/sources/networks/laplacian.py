"""The image's Laplacian in a network's place, as `sobel`: the absolute 13x13 Laplacian of the grey image.

A 3x3 Laplacian answers to single pixels, which the paper's blur of 9x9 washes out.
"""

from __future__ import annotations

from dataclasses import replace
from math import comb

import torch

from . import sobel
from .parts.architecture import Architecture, Maps, Part

LAPLACE_SIZE = 13


def laplace(size: int) -> torch.Tensor:
    """(size, size): s d^T + d s^T, with s the binomial of `size`, and d that of `size` - 2 differentiated twice.

    s_k = C(size - 1, k),  d_k = b_k - 2 b_(k-1) + b_(k-2) with b_k = C(size - 3, k)
    """
    s = [comb(size - 1, k) for k in range(size)]
    b = [0, 0, *(comb(size - 3, k) for k in range(size - 2)), 0, 0]
    d = [b[k + 2] - 2 * b[k + 1] + b[k] for k in range(size)]
    # In plain numbers: traced, operations on tensors would become nodes of the graph.
    return torch.tensor([[float(s[i] * d[j] + d[i] * s[j]) for j in range(size)] for i in range(size)])


def laplacian(part: Part, x: torch.Tensor) -> Maps:
    """|gxx + gyy|"""
    del part
    yield "magnitude", torch.abs(sobel.filtered(x, laplace(LAPLACE_SIZE)))


_ARCHITECTURE = Architecture({}, laplacian)

NETWORK = replace(
    sobel.NETWORK,
    name="laplacian",
    title="Absolute Laplacian of the image, no network",
    layers=_ARCHITECTURE.layers,
    build=_ARCHITECTURE.build,
    tensor_shapes=_ARCHITECTURE.tensor_shapes,
)
