"""Ops that ONNX Runtime fuses, as the chains of standard ones that they were made from."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from elf_export.graph.graph import attributes

from .writer import MICROSOFT, Writer


def _fused_conv(w: Writer) -> None:
    """act(W * x + b + z)."""
    attrs = attributes(w.node)
    activation, params = attrs.pop("activation", ""), attrs.pop("activation_params", [])
    added = w.input(3)
    y = w.op("Conv", *w.node.input[:3], role="conv" if activation or added else "", **attrs)
    if added:
        y = w.op("Add", y, added, role="sum" if activation else "")
    if activation:
        _activation(w, y, activation, params)


def _activation(w: Writer, y: str, kind: str, params: list[float]) -> None:
    if kind == "Clip":
        low, high = (w.const(v, role) for v, role in zip(params, ("low", "high"), strict=True))
        w.op("Clip", y, low, high)
    else:
        given: dict[str, Any] = dict(zip(("alpha", "beta"), params, strict=False))
        w.op(kind, y, **given)


def _fused_gemm(w: Writer) -> None:
    """act(alpha A B + beta C)."""
    attrs = attributes(w.node)
    activation = attrs.pop("activation", "")
    params = [attrs.pop(key) for key in ("activation_alpha", "activation_beta") if key in attrs]
    attrs.pop("activation_gamma", None)
    y = w.op("Gemm", *w.node.input, role="gemm" if activation else "", **attrs)
    if activation:
        _activation(w, y, activation, params)


def _gelu(w: Writer) -> None:
    """x (1 + erf(x / sqrt 2)) / 2, of the sum of both inputs where there are two."""
    x = w.op("Add", *w.node.input, role="sum") if w.input(1) else w.node.input[0]
    scaled = w.op("Mul", x, w.const(math.sqrt(0.5), "root"), role="scaled")
    curve = w.op("Add", w.op("Erf", scaled, role="erf"), w.const(1, "one"), role="curve")
    w.op("Mul", w.op("Mul", x, w.const(0.5, "half"), role="halved"), curve)


def _quick_gelu(w: Writer) -> None:
    """x sigmoid(alpha x)."""
    alpha = w.const(attributes(w.node).get("alpha", 1.702), "alpha")
    w.op("Mul", w.node.input[0], w.op("Sigmoid", w.op("Mul", w.node.input[0], alpha, role="scaled"), role="gate"))


FUSED: dict[tuple[str, str], Callable[[Writer], None]] = {
    (MICROSOFT, "FusedConv"): _fused_conv,
    (MICROSOFT, "FusedGemm"): _fused_gemm,
    (MICROSOFT, "Gelu"): _gelu,
    (MICROSOFT, "BiasGelu"): _gelu,
    (MICROSOFT, "QuickGelu"): _quick_gelu,
}
