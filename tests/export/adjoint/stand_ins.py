"""Float64 stand-ins for ops that ONNX's reference evaluator gets wrong, all of them written in torch.

Erf, Gelu, LRN and GroupNormalization come out in single precision; ConvTranspose with groups raises, as do a
Mean whose first input is broadcast and a Dropout with all three inputs; LpNormalization with p = 1 forgets
the absolute value.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F
from onnx.reference.op_run import OpRun

Array = npt.NDArray[Any]


class Erf(OpRun):
    op_domain = ""

    def _run(self, x: Array) -> tuple[Array]:
        return (torch.erf(torch.from_numpy(np.array(x))).numpy(),)


class Gelu(OpRun):
    op_domain = ""

    def _run(self, x: Array, approximate: str = "none") -> tuple[Array]:
        return (F.gelu(torch.from_numpy(np.array(x)), approximate=approximate).numpy(),)


class Mean(OpRun):
    op_domain = ""

    def _run(self, *inputs: Array) -> tuple[Array]:
        return (sum(inputs[1:], inputs[0]) / len(inputs),)


class Dropout(OpRun):
    op_domain = ""

    def _run(
        self, x: Array, ratio: Array | None = None, training: Array | None = None, seed: int = 0
    ) -> tuple[Array, ...]:
        assert training is None or not training
        del ratio, seed
        return (x, np.ones(x.shape, bool))[: len(self.onnx_node.output)]


class LpNormalization(OpRun):
    op_domain = ""

    def _run(self, x: Array, axis: int = -1, p: int = 2) -> tuple[Array]:
        return (x / np.linalg.norm(x, p, axis, keepdims=True),)


class LRN(OpRun):
    op_domain = ""

    def _run(self, x: Array, alpha: float = 1e-4, beta: float = 0.75, bias: float = 1.0, size: int = 1) -> tuple[Array]:
        numbers = (float(v) for v in (alpha, beta, bias))  # they come as float32
        return (local_response(torch.from_numpy(np.array(x)), size, *numbers).numpy(),)


class GroupNormalization(OpRun):
    op_domain = ""

    def _run(
        self,
        x: Array,
        scale: Array,
        bias: Array,
        num_groups: int = 1,
        epsilon: float = 1e-5,
        stash_type: int = 1,
    ) -> tuple[Array]:
        del stash_type
        tensors = [torch.from_numpy(np.array(v)) for v in (x, scale, bias)]
        return (F.group_norm(tensors[0], num_groups, *tensors[1:], float(epsilon)).numpy(),)


class ConvTranspose(OpRun):
    op_domain = ""

    def _run(
        self, x: Array, w: Array, b: Array | None = None, *, auto_pad: str | None = None,
        dilations: list[int] | None = None, group: int | None = None, kernel_shape: list[int] | None = None,
        output_padding: list[int] | None = None, output_shape: list[int] | None = None,
        pads: list[int] | None = None, strides: list[int] | None = None,
    ) -> tuple[Array]:  # fmt: skip
        assert not output_shape
        del kernel_shape
        n = x.ndim - 2
        y = transposed(
            torch.from_numpy(np.array(x)), torch.from_numpy(np.array(w)),
            None if b is None else torch.from_numpy(np.array(b)),
            stride=strides or [1] * n, pads=pads or [0] * 2 * n, rest=output_padding or [0] * n,
            dilation=dilations or [1] * n, group=group or 1, auto_pad=auto_pad or "NOTSET",
        )  # fmt: skip
        return (y.numpy(),)


def transposed(
    x: torch.Tensor, w: torch.Tensor, b: torch.Tensor | None, *, stride: list[int], pads: list[int],
    rest: list[int], dilation: list[int], group: int = 1, auto_pad: str = "NOTSET",
) -> torch.Tensor:  # fmt: skip
    """ONNX's ConvTranspose: torch's without padding, then room behind, then the pads cut off."""
    n = x.ndim - 2
    function = [F.conv_transpose1d, F.conv_transpose2d, F.conv_transpose3d][n - 1]
    full = function(x, w, b, stride=stride, groups=group, dilation=dilation)
    room = [r for axis in reversed(range(n)) for r in (0, rest[axis])]
    full = F.pad(full, room) if b is None else F.pad(full - b.view(-1, *[1] * n), room) + b.view(-1, *[1] * n)
    if auto_pad.startswith("SAME"):
        surplus = [full.shape[2 + i] - x.shape[2 + i] * stride[i] for i in range(n)]
        small, large = [s // 2 for s in surplus], [s - s // 2 for s in surplus]
        pads = [*small, *large] if auto_pad == "SAME_UPPER" else [*large, *small]
    for i in range(n):
        full = full.narrow(2 + i, pads[i], full.shape[2 + i] - pads[i] - pads[n + i])
    return full


def local_response(x: torch.Tensor, size: int, alpha: float, beta: float, bias: float) -> torch.Tensor:
    """ONNX's LRN: floor((size - 1) / 2) channels before and ceil((size - 1) / 2) behind."""
    squares = F.pad((x * x).transpose(1, -1), [(size - 1) // 2, math.ceil((size - 1) / 2)])
    total = squares.unfold(-1, size, 1).sum(-1).transpose(1, -1)
    return x / (bias + alpha / size * total) ** beta


STAND_INS = [Erf, Gelu, Mean, Dropout, LpNormalization, LRN, GroupNormalization, ConvTranspose]
