"""Gradients that come back to a convolution's responses, against torch.autograd."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
import torch
import torch.nn.functional as F
from onnx import helper, numpy_helper

from elf_export.compression.convolutions import Convolution
from elf_export.compression.gradients import response_gradients
from elf_export.graph.graph import Graph
from export.small_models import model as small_model
from export.small_models import weights

pytestmark = pytest.mark.torch

KERNELS = {"w1": weights(6, 3, 3, 3), "w2": weights(6, 6, 3, 3, seed=2)}


def network(skip: bool) -> onnx.ModelProto:
    nodes = [
        helper.make_node("Conv", ["x", "w1"], ["y"], name="y", pads=[1] * 4),
        helper.make_node("Relu", ["y"], ["relu"], name="relu"),
        helper.make_node("Conv", ["relu", "w2"], ["z"], name="z", pads=[1] * 4),
        helper.make_node("Conv", ["x", "w1"], ["other"], name="other", pads=[1] * 4),
        helper.make_node("Add", ["z", "other"] if skip else ["z", "z"], ["f"], name="f"),
    ]
    return small_model(nodes, KERNELS, ("N", 3, "H", "W"), "f")


@pytest.mark.parametrize(("skip", "layer"), [(False, "f"), (True, "f"), (False, "y")])
def test_moments_are_autograd_s(skip: bool, layer: str) -> None:
    pictures = [np.random.default_rng(k).standard_normal((1, 3, 14, 11 + k)).astype(np.float32) for k in range(2)]
    net = network(skip)
    w1, w2 = (torch.tensor(numpy_helper.to_array(t)).double() for t in net.graph.initializer)
    wanted = torch.zeros(6, 6, dtype=torch.float64)
    for picture in pictures:
        x = torch.tensor(picture).double()
        y = F.conv2d(x, w1, padding=1).requires_grad_(True)
        z = F.conv2d(torch.relu(y), w2, padding=1)
        f = y if layer == "y" else z + (F.conv2d(x, w1, padding=1) if skip else z)
        (g,) = torch.autograd.grad(0.5 * f.square().sum(), y)
        rows = g[0].flatten(1)
        wanted += rows @ rows.T / rows.square().sum()
    conv = Convolution("y", "y", KERNELS["w1"], np.zeros(6, np.float32), True)
    values, vectors = np.linalg.eigh(np.tensordot(KERNELS["w1"], KERNELS["w1"], axes=([1, 2, 3], [1, 2, 3])))
    root = vectors @ np.diag(np.sqrt(values)) @ vectors.T
    found = response_gradients(Graph(net), conv, layer, "x", lambda: pictures)
    np.testing.assert_allclose(found, root @ wanted.numpy() @ root, atol=1e-5)
