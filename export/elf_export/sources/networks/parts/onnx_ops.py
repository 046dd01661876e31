"""Operations that ONNX has and torch's exporter would write as a dozen nodes, or for one image size only.

Each computes with torch's own functions, so that torch.autograd differentiates it, and is written to a file
as the one ONNX node that means the same; verification holds the two against each other.
"""

from __future__ import annotations

from typing import Any

import torch
from torch.nn import functional as F


def same_max_pool(x: torch.Tensor, kernel: int, stride: int) -> torch.Tensor:
    """Max-pooling under TensorFlow's SAME padding.

    An axis of H pixels gets max((ceil(H / s) - 1) s + k - H, 0) pixels of padding, the odd one at the end:
    how much, and therefore where the windows lie, depends on H.
    """
    if torch.onnx.is_in_onnx_export():
        y: torch.Tensor = _SameMaxPool.apply(x, kernel, stride)  # type: ignore[no-untyped-call]
        return y
    pads: list[int] = []
    for size in (x.shape[3], x.shape[2]):
        total = max((-(-size // stride) - 1) * stride + kernel - size, 0)
        pads += [total // 2, total - total // 2]
    return F.max_pool2d(F.pad(x, pads, value=float("-inf")), kernel, stride)


def local_response_norm(x: torch.Tensor, size: int, alpha: float, beta: float, k: float) -> torch.Tensor:
    """y_c = x_c / (k + alpha / size * sum of x_c'^2 over the `size` channels around c)^beta"""
    if torch.onnx.is_in_onnx_export():
        y: torch.Tensor = _LocalResponseNorm.apply(x, size, alpha, beta, k)  # type: ignore[no-untyped-call]
        return y
    return F.local_response_norm(x, size, alpha, beta, k)


class _SameMaxPool(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, kernel: int, stride: int) -> torch.Tensor:
        del ctx
        return F.max_pool2d(x, kernel, stride, (kernel - 1) // 2)  # traced for its rank and type

    @staticmethod
    def symbolic(g: Any, x: Any, kernel: int, stride: int) -> Any:
        # Left without a type: torch has none for sizes that depend on the image's.
        return g.op("MaxPool", x, kernel_shape_i=[kernel, kernel], strides_i=[stride, stride], auto_pad_s="SAME_UPPER")


class _LocalResponseNorm(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: torch.Tensor, size: int, alpha: float, beta: float, k: float) -> torch.Tensor:
        del ctx
        return F.local_response_norm(x, size, alpha, beta, k)

    @staticmethod
    def symbolic(g: Any, x: Any, size: int, alpha: float, beta: float, k: float) -> Any:
        return g.op("LRN", x, size_i=size, alpha_f=alpha, beta_f=beta, bias_f=k).setType(x.type())
