"""Differences, masks and sums as depthwise convolutions, in the blocked layout in which ONNX Runtime convolves.

A step of one is run by ONNX Runtime as one operator with it, in that layout.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from elf_export.dialect import emit

from .site import Site

FEW = 16  # channels of one block of the blocked layout (AVX-512); a convolution to fewer pays for all of them


def convolve(
    site: Site,
    x: str,
    kernel: npt.ArrayLike,
    strides: list[int],
    role: str,
    pads: Sequence[int] = (0, 0, 0, 0),
    bias: float | None = None,
    dilations: list[int] | None = None,
) -> str:
    """Each channel of x, which has as many as `site.like`, convolved with the same small kernel.

    `pads` are the rows of zeros above x, the columns on its left, the rows below and the columns on its right.
    """
    channels, size = site.known_channels, list(np.shape(kernel))
    inputs = [x, site.const(np.broadcast_to(kernel, (channels, 1, *size)), f"{role}_kernel", like=site.like)]
    if bias is not None:
        inputs.append(site.const(np.broadcast_to(bias, channels), f"{role}_bias", like=site.like))
    return site.op(
        "Conv", *inputs, role=role,
        kernel_shape=size, strides=strides, group=channels, pads=list(pads), dilations=dilations,
    )  # fmt: skip


def step(
    site: Site,
    x: str,
    kernel: npt.ArrayLike,
    strides: list[int],
    role: str,
    pads: Sequence[int] = (0, 0, 0, 0),
    dilations: list[int] | None = None,
) -> str:
    """[d > 0] with d = `convolve` of the same arguments."""
    difference = convolve(site, x, kernel, strides, f"{role}_difference", pads, dilations=dilations)
    return emit.step(site, difference, role)


def minus(site: Site, a: str, b: str, role: str) -> str:
    """a - b as a sum, which the convolution that negates b does in place."""
    negated = convolve(site, b, [[-1]], [1, 1], f"{role}_minus")
    return site.op("Add", negated, a, role=role)
