"""A strided convolution: its adjoint in phases, exact for every kernel, padding and parity."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper

from elf_export.graph.graph import Graph, attributes
from elf_export.graph.windows import Window
from elf_export.lowering import phases
from elf_export.saliency import SALIENCY, build_saliency
from export.adjoint.runs import differentiated as with_gradient

from .chains import evaluated

CHANNELS, RESULTS = 3, 6
# (kernel), (pads at the top, on the left, below, on the right)
FORMS = [
    ((3, 3), (0, 0, 0, 0)),  # Xception's and SqueezeNet's first
    ((3, 3), (1, 1, 1, 1)),  # the MobileNets'
    ((7, 7), (3, 3, 3, 3)),  # ResNet's
    ((3, 3), (0, 0, 1, 1)),  # TensorFlow's SAME, of even sizes
    ((2, 2), (0, 0, 0, 0)),
    ((1, 1), (0, 0, 0, 0)),
    ((4, 5), (1, 2, 2, 0)),
    ((5, 2), (4, 1, 0, 1)),
]
# Whose phases, of one convolution, would take more than twice the layer's own multiplications, for all its zeros.
WASTEFUL = [((1, 1), (0, 0, 0, 0)), ((5, 2), (4, 1, 0, 1))]
FARTHER = [
    ((11, 11), (0, 0, 0, 0), 4),  # AlexNet's
    ((4, 4), (0, 0, 0, 0), 4),  # ConvNeXt's
    ((7, 7), (3, 3, 3, 3), 4),
    ((6, 4), (1, 0, 2, 3), 4),
    ((5, 5), (2, 2, 2, 2), 3),
    ((3, 3), (0, 0, 0, 0), 3),
]


def layer(kernel: np.ndarray, pads: tuple[int, ...], **attributes: object) -> onnx.ModelProto:
    """x (N, 3, H, W) -> Conv -> y"""
    tensors = [numpy_helper.from_array(kernel, "w")]
    given = {"strides": [2, 2], "pads": list(pads)} | attributes
    node = helper.make_node("Conv", ["x", "w"], ["y"], name="y", **given)
    infos = [
        helper.make_tensor_value_info(name, TensorProto.DOUBLE, ["N", channels, h, w])
        for name, channels, h, w in (("x", CHANNELS, "H", "W"), ("y", len(kernel), "h", "w"))
    ]
    graph = helper.make_graph([node], "g", infos[:1], infos[1:], tensors)
    return helper.make_model(graph, ir_version=8, opset_imports=[helper.make_opsetid("", 17)])


def problem(
    kernel: tuple[int, int],
    pads: tuple[int, ...],
    size: tuple[int, int],
    stride: int = 2,
    depthwise: bool = False,
) -> tuple[onnx.ModelProto, np.ndarray, np.ndarray]:
    """The model, images, and the gradient of 1/2 |y|^2 there by torch."""
    rng = np.random.default_rng(0)
    channels, groups = ((CHANNELS, 1), CHANNELS) if depthwise else ((RESULTS, CHANNELS), 1)
    weight, x = rng.standard_normal((*channels, *kernel)), rng.standard_normal((2, CHANNELS, *size))
    image = torch.tensor(x, requires_grad=True)
    framed = torch.nn.functional.pad(image, [pads[1], pads[3], pads[0], pads[2]])
    y = torch.nn.functional.conv2d(framed, torch.tensor(weight), stride=stride, groups=groups)
    (wanted,) = torch.autograd.grad(y, image, y.detach())
    return layer(weight, pads, group=groups, strides=[stride] * 2), x, wanted.numpy()


@pytest.mark.parametrize(("kernel", "pads"), FORMS)
@pytest.mark.parametrize("size", [(12, 16), (13, 17), (12, 17), (7, 8)])
def test_exact_in_float64(kernel: tuple[int, int], pads: tuple[int, ...], size: tuple[int, int]) -> None:
    graph, gradient, x, wanted = differentiated(kernel, pads, size, 2)
    assert any(node.op_type == "ConvTranspose" for node in graph.nodes) is ((kernel, pads) in WASTEFUL)
    np.testing.assert_allclose(evaluated(graph, gradient, x), wanted, atol=1e-11)


@pytest.mark.parametrize(("kernel", "pads", "stride"), FARTHER)
@pytest.mark.parametrize("size", [(12, 16), (13, 17), (14, 18), (15, 19)])
def test_of_more_phases(kernel: tuple[int, int], pads: tuple[int, ...], stride: int, size: tuple[int, int]) -> None:
    graph, gradient, x, wanted = differentiated(kernel, pads, size, stride)
    assert not any(node.op_type == "ConvTranspose" for node in graph.nodes)
    np.testing.assert_allclose(evaluated(graph, gradient, x), wanted, atol=1e-11)


def differentiated(
    kernel: tuple[int, int], pads: tuple[int, ...], size: tuple[int, int], stride: int
) -> tuple[Graph, str, np.ndarray, np.ndarray]:
    """The graph with the gradient built in, the gradient's name, images, and torch's gradient there."""
    model, x, wanted = problem(kernel, pads, size, stride)
    graph = Graph(model)
    return graph, with_gradient(graph, "y", "x"), x, wanted


@pytest.mark.parametrize(("kernel", "pads"), [*FORMS, ((3, 3), (1, 0, 1, 1)), ((5, 5), (2, 2, 2, 2))])
@pytest.mark.parametrize("size", [(12, 16), (13, 17), (12, 17), (7, 8)])
def test_depthwise_in_four_phases(kernel: tuple[int, int], pads: tuple[int, ...], size: tuple[int, int]) -> None:
    """Where every phase has a tap, and rows and columns are as many as each other's phases have."""
    model, x, wanted = problem(kernel, pads, size, depthwise=True)
    graph = Graph(model)
    gradient = with_gradient(graph, "y", "x")
    over = [k - pads[axis] - pads[axis + 2] for axis, k in enumerate(kernel)]
    alike = min(kernel) > 1 and over[0] % 2 == over[1] % 2
    assert any(node.op_type == "ConvTranspose" for node in graph.nodes) is not alike
    np.testing.assert_allclose(evaluated(graph, gradient, x), wanted, atol=1e-11)


@pytest.mark.parametrize(("kernel", "pads", "stride"), [((3, 3), (1, 1, 1, 1), 2), *FARTHER])
@pytest.mark.parametrize("size", [(12, 16), (13, 17), (14, 18), (15, 19)])
def test_the_saliency_averages_in_phases(
    kernel: tuple[int, int], pads: tuple[int, ...], stride: int, size: tuple[int, int]
) -> None:
    model, x, wanted = problem(kernel, pads, size, stride)
    graph = Graph(build_saliency(model, "y"))
    (join,) = (node for node in graph.nodes if node.op_type == "ConvTranspose")
    assert graph.shape(join.output[0])[1] == 1  # one channel to put together
    np.testing.assert_allclose(evaluated(graph, SALIENCY, x), np.abs(wanted).mean(axis=1), atol=1e-11)


@pytest.mark.parametrize(
    ("pads", "attributes"),
    [
        ((1, 1, 1, 1), {"strides": [4, 4]}),  # three of four rows are read by no window
        ((1, 1, 1, 1), {"strides": [5, 5]}),
        ((1, 1, 1, 1), {"strides": [2, 1]}),
        ((2, 2, 2, 2), {"dilations": [2, 2]}),
        ((2, 2, 2, 2), {}),  # more padding than kernel: windows that see none of the image
        ((3, 3, 0, 0), {}),
        ((1, 1, 1, 1), {"group": 3}),  # two results of each channel
    ],
)
def test_other_forms_stay_with_the_transposed_convolution(pads: tuple[int, ...], attributes: dict[str, object]) -> None:
    weight = np.random.default_rng(0).standard_normal((RESULTS, 1 if "group" in attributes else CHANNELS, 3, 3))
    graph = Graph(layer(weight, pads, **attributes))
    with_gradient(graph, "y", "x")
    assert any(node.op_type == "ConvTranspose" for node in graph.nodes)


@pytest.mark.parametrize(("size", "stride", "pad"), [(3, 2, 1), (3, 3, 1), (2, 3, 0), (3, 4, 0), (2, 4, 1)])
@pytest.mark.parametrize("channels", [3, 16])
def test_8_bit_graphs_have_plain_convolutions(channels: int, size: int, stride: int, pad: int) -> None:
    """Of any number of channels: one for all phases where they are few, one for each where they are many.

    A stride beyond the kernel leaves phases without a tap, some along one axis only.
    """
    rng = np.random.default_rng(0)
    weight, x = rng.standard_normal((RESULTS, channels, size, size)), rng.standard_normal((2, channels, 13, 17))
    image = torch.tensor(x, requires_grad=True)
    y = torch.nn.functional.conv2d(image, torch.tensor(weight), stride=stride, padding=pad)
    (wanted,) = torch.autograd.grad(y, image, y.detach())
    model = layer(weight, (pad,) * 4, strides=[stride] * 2)
    model.graph.input[0].type.tensor_type.shape.dim[1].dim_value = channels
    graph = Graph(model)
    gradient = with_gradient(graph, "y", "x", lowering="int8")
    convolutions = [node for node in graph.nodes if node.op_type == "Conv" and node.name.startswith("adj/")]
    assert len(convolutions) == (1 if channels == CHANNELS else stride**2)
    assert not any(node.op_type == "ConvTranspose" for node in graph.nodes)
    np.testing.assert_allclose(evaluated(graph, gradient, x), wanted.numpy(), atol=1e-11)
    # ONNX Runtime holds kernel_shape against the kernel, the reference evaluator does not.
    for node in convolutions:
        assert graph.shape(node.input[1])[2:] == attributes(node)["kernel_shape"]


def test_a_mistake_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """Taps one row and column further; phases in another order; too few rows and columns."""
    taps, overhang = phases._taps, phases.overhang

    def further(window: Window, *others: Any) -> list[tuple[int, int, int]]:
        assert window.begin is not None
        return taps(dataclasses.replace(window, begin=tuple(b + 1 for b in window.begin)), *others)

    def exact() -> None:
        test_exact_in_float64((3, 3), (1, 1, 1, 1), (13, 17))

    def of_more_phases() -> None:
        test_of_more_phases((3, 3), (0, 0, 0, 0), 3, (14, 18))

    def depthwise() -> None:
        test_depthwise_in_four_phases((3, 3), (1, 1, 1, 1), (13, 17))

    mistakes: list[tuple[str, object, list[Callable[[], None]]]] = [
        ("_taps", further, [exact, depthwise]),
        ("all_phases", lambda step: list(np.ndindex(step, step))[::-1], [depthwise]),
        ("overhang", lambda window: [1, 1] if window.strides[0] == 3 else overhang(window), [of_more_phases]),
    ]
    for name, wrong, tests in mistakes:
        with monkeypatch.context() as patch:
            patch.setattr(phases, name, wrong)
            for test in tests:
                with pytest.raises((AssertionError, ValueError)):
                    test()
