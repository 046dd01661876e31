"""Whole small networks of the usual kinds, exported with symbolic sizes, against autograd in float64."""

from __future__ import annotations

import io
import logging
import warnings

import numpy as np
import onnx
import pytest
import torch
import torch.nn.functional as F
from onnx import helper
from torch import nn

from elf_export.graph.graph import Graph
from elf_export.graph.passes import fold_constants

from .oracles import assert_standard
from .runs import differentiated, run_ort

pytestmark = pytest.mark.torch


class Residual(nn.Module):
    """A ResNet: strided and padded convolutions, BatchNorm, a projection and a plain shortcut."""

    def __init__(self) -> None:
        super().__init__()
        self.stem, self.norm = nn.Conv2d(3, 6, 7, 2, 3, bias=False), nn.BatchNorm2d(6)
        self.a, self.b = nn.Conv2d(6, 6, 3, padding=1), nn.Conv2d(6, 6, 3, padding=1)
        self.c, self.d, self.short = nn.Conv2d(6, 8, 3, 2, 1), nn.Conv2d(8, 8, 3, 1, 1), nn.Conv2d(6, 8, 1, 2)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        x = F.max_pool2d(self.norm(self.stem(x)).relu(), 3, 2, 1)
        x = (x + self.b(self.a(x).relu())).relu()
        return (self.short(x) + self.d(self.c(x).relu())).relu()


class Mobile(nn.Module):
    """A MobileNetV3 block: depthwise convolution, hard swish, squeeze and excitation."""

    def __init__(self) -> None:
        super().__init__()
        self.up, self.depth, self.down = (
            nn.Conv2d(3, 8, 1),
            nn.Conv2d(8, 8, 5, 2, 2, groups=8),
            nn.Conv2d(8, 4, 1),
        )
        self.squeeze, self.excite = nn.Conv2d(8, 2, 1), nn.Conv2d(2, 8, 1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        x = F.hardswish(self.depth(F.hardswish(self.up(x))))
        gate = F.adaptive_avg_pool2d(x, 1)
        return self.down(x * F.hardsigmoid(self.excite(self.squeeze(gate).relu())))


class Dense(nn.Module):
    """A DenseNet with a U-Net's way back: concatenation, average pooling, upsampling to a given size."""

    def __init__(self) -> None:
        super().__init__()
        self.a, self.b, self.c = (
            nn.Conv2d(3, 4, 3, padding=1),
            nn.Conv2d(7, 4, 3, padding=1),
            nn.Conv2d(15, 5, 3),
        )
        self.t = nn.ConvTranspose2d(4, 4, 2, 2)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        a = F.leaky_relu(self.a(x), 0.1)
        b = torch.cat([x, a], 1)
        low = F.elu(self.b(F.avg_pool2d(b, 2)))
        bilinear = F.interpolate(low, size=x.shape[-2:], mode="bilinear", align_corners=False)
        nearest = F.interpolate(F.silu(low), scale_factor=2.0, mode="nearest")
        deep = F.pad(nearest + self.t(low), (0, 1, 0, 1))[:, :, : x.shape[2], : x.shape[3]]
        return self.c(torch.cat([b, bilinear, deep], 1))


class Transformer(nn.Module):
    """A ViT block on patches: reshape, LayerNorm, attention, GELU."""

    def __init__(self) -> None:
        super().__init__()
        self.patch, self.norm, self.qkv = nn.Conv2d(3, 8, 4, 4), nn.LayerNorm(8), nn.Linear(8, 24)
        self.out, self.up, self.down = nn.Linear(8, 8), nn.Linear(8, 16), nn.Linear(16, 8)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        x = self.patch(x).flatten(2).transpose(1, 2)
        q, k, v = (t.reshape(t.shape[0], -1, 2, 4).transpose(1, 2) for t in self.qkv(self.norm(x)).chunk(3, -1))
        weights = (q @ k.transpose(-1, -2) * 0.5).softmax(-1)
        x = x + self.out((weights @ v).transpose(1, 2).flatten(2))
        return x + self.down(F.gelu(self.up(self.norm(x))))


class Normalized(nn.Module):
    """What descriptor networks do: instance and group norms, slices, pixel shuffle, unit vectors."""

    def __init__(self) -> None:
        super().__init__()
        self.a, self.b = (
            nn.Conv2d(12, 8, 3, padding=1, padding_mode="reflect"),
            nn.Conv2d(8, 8, 3, padding=2, dilation=2),
        )
        self.instance, self.group, self.act = (
            nn.InstanceNorm2d(8, affine=True),
            nn.GroupNorm(2, 8),
            nn.PReLU(8),
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        x = torch.cat([x[..., ::2, ::2], x[..., 1::2, ::2], x[..., ::2, 1::2], x[..., 1::2, 1::2]], 1)
        x = self.group(self.b(self.act(self.instance(self.a(x)))))
        x = F.normalize(F.pixel_shuffle(x, 2), dim=1)
        return x - x.mean(dim=(2, 3), keepdim=True) + x.amax(dim=1, keepdim=True).clamp(-0.5, 0.5)


def exported(module: nn.Module, opset: int) -> onnx.ModelProto:
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    buffer = io.BytesIO()
    axes = {"x": {0: "N", 2: "H", 3: "W"}}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            module, (torch.zeros(2, 3, 16, 24),), buffer, input_names=["x"], output_names=["y"],
            dynamic_axes=axes, opset_version=opset, dynamo=False,
        )  # fmt: skip
    return onnx.load_from_string(buffer.getvalue())


SIZES = [(1, 3, 16, 24), (2, 3, 20, 12)]
ODD = (1, 3, 23, 37)
NETWORKS = [
    (Residual, (11, 13, 17, 20), [*SIZES, ODD]),
    (Mobile, (11, 14, 17, 20), [*SIZES, ODD]),
    (Dense, (13, 17, 18, 20), [*SIZES]),
    (Transformer, (13, 17, 20), SIZES),
    (Normalized, (13, 17, 18, 20), SIZES),
]


@pytest.mark.parametrize(
    ("kind", "opset", "shapes"),
    [(kind, opset, shapes) for kind, opsets, shapes in NETWORKS for opset in opsets],
)
def test_network(kind: type[nn.Module], opset: int, shapes: list[tuple[int, ...]]) -> None:
    """F^T dF/dI, the layer being its own seed."""
    torch.manual_seed(0)
    module = kind().eval()
    graph = fold_constants(Graph(exported(module, opset)))
    gradient = differentiated(graph, "y", "x")
    graph.op("Identity", gradient, name="result", outputs=["dx"])
    graph.model.graph.output.append(helper.make_tensor_value_info("dx", 1, ["N", 3, "H", "W"]))
    graph.model.ir_version = min(graph.model.ir_version, 10)
    assert_standard(graph.model, names=False)
    module = module.double()
    for shape in shapes:
        x = np.random.default_rng(1).standard_normal(shape).astype(np.float32)
        leaf = torch.tensor(x, dtype=torch.float64, requires_grad=True)
        y = module(leaf)
        (grad,) = torch.autograd.grad(y, leaf, y.detach())
        expected_y, expected = y.detach().numpy(), grad.numpy()
        got_y, got = run_ort(graph.model, {"x": x})
        np.testing.assert_allclose(got_y, expected_y, atol=1e-4 * np.abs(expected_y).max())
        # Rounding, and nothing else: no pixel of these inputs lies on a kink.
        np.testing.assert_allclose(got, expected, atol=2e-5 * np.abs(expected).max())
