"""A torch network with average-pooling in place of its max-pooling."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch.nn import functional as F
from torch.overrides import TorchFunctionMode


class Averaging(torch.nn.Module):
    """`module`, each of whose max-poolings gives the means of its windows; what is padded counts for nothing."""

    def __init__(self, module: torch.nn.Module) -> None:
        super().__init__()
        self.module = module

    def forward(self, x: torch.Tensor) -> Any:
        with _MeansForMaxima():
            return self.module(x)


class _MeansForMaxima(TorchFunctionMode):
    def __torch_function__(
        self, func: Callable[..., Any], types: Any, args: Sequence[Any] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        if func is F.max_pool2d:
            return _means(*args, **(kwargs or {}))
        return func(*args, **(kwargs or {}))


def _means(
    x: torch.Tensor,
    kernel_size: Any,
    stride: Any = None,
    padding: Any = 0,
    dilation: Any = 1,
    ceil_mode: bool = False,
    return_indices: bool = False,
) -> torch.Tensor:
    """The mean of each window's finite values: SAME padding comes as minus infinity."""
    if dilation not in (1, (1, 1)) or return_indices:
        raise NotImplementedError("a max-pooling with dilated windows or indices")
    finite = torch.isfinite(x)
    total, count = (
        F.avg_pool2d(values, kernel_size, stride, padding, ceil_mode, divisor_override=1)
        for values in (x.where(finite, 0.0), finite.to(x.dtype))
    )
    return total / count
