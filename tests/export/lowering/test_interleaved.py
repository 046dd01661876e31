"""Max-pooling's adjoint channels last: exact in float64, and of ones and zeros where an 8-bit graph needs them."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from onnx import TensorProto, helper

from elf_export.graph.graph import Graph
from elf_export.lowering import common, depthwise, pools
from elf_export.lowering.site import Site
from export.adjoint.runs import differentiated as with_gradient

from .chains import CHAINS, CHANNELS, KERNELS, SIZES, by_torch, chain, evaluated, problem


def differentiated(layers: list[str], kernels: dict[str, np.ndarray], seed: str | None = None) -> tuple[Graph, str]:
    graph = Graph(chain(layers, kernels))
    output = graph.model.graph.output[0]
    if seed is not None:
        shape = graph.shape(output.name)
        graph.model.graph.input.append(helper.make_tensor_value_info(seed, TensorProto.DOUBLE, shape))
    gradient = with_gradient(graph, output.name, "x", seed, "int8")
    joins = sum(node.name.endswith("/interleaved") for node in graph.nodes)
    assert joins == sum(kind == "pool" or kind.startswith("down") for kind in layers)
    assert not any(node.op_type == "DepthToSpace" for node in graph.nodes)  # no phases
    return graph, gradient


@pytest.mark.parametrize("name", CHAINS)
@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("size", SIZES)
def test_exact_in_float64(name: str, kernel: tuple[int, int], size: tuple[int, int]) -> None:
    layers, kernels, x, drawn = problem(name, kernel, size)
    graph, gradient = differentiated(layers, kernels)
    found, wanted = evaluated(graph, gradient, x), by_torch(layers, kernels, x)
    assert found.shape == wanted.shape
    assert np.abs(found - wanted).max() <= 1e-10 * np.abs(wanted).max(), f"seed {drawn}"


@pytest.mark.parametrize("layers", [["pool"], ["conv1", "relu", "pool"], ["conv1", "relu", "pool", "pool"]])
def test_a_seed_of_any_sign(layers: list[str]) -> None:
    """Behind a ReLU the adjoint clears the seed where the pool's value is zero: for any seed, not for F alone."""
    rng = np.random.default_rng(0)
    kernels = {"conv1": rng.standard_normal((CHANNELS, 3, 3, 3))}
    x = rng.standard_normal((2, 3, 9, 12))
    graph, gradient = differentiated(layers, kernels, "given")
    shape = (2, CHANNELS if "conv1" in layers else 3, *(side >> layers.count("pool") for side in (9, 12)))
    given = rng.standard_normal(shape)
    image = torch.tensor(x, requires_grad=True)
    value = image
    for layer in layers:
        if layer == "conv1":
            value = torch.nn.functional.conv2d(value, torch.tensor(kernels["conv1"]), padding=1)
        else:
            value = value.relu() if layer == "relu" else torch.nn.functional.max_pool2d(value, 2)
    (wanted,) = torch.autograd.grad(value, image, torch.tensor(given))
    np.testing.assert_allclose(evaluated(graph, gradient, x, given=given), wanted.numpy(), atol=1e-12)


def test_a_tie_goes_to_the_first_in_raster_order() -> None:
    """All 15 ways in which places of a window tie for its maximum."""
    windows = np.array([[(code >> place) & 1 for place in range(4)] for code in range(1, 16)], np.float64)
    x = np.repeat(windows.reshape(1, 15, 2, 2).transpose(0, 2, 1, 3).reshape(1, 1, 2, 30), 3, axis=1)
    graph, gradient = differentiated(["pool"], {})
    found = evaluated(graph, gradient, x).reshape(3, 2, 15, 2).transpose(0, 2, 1, 3).reshape(3, 15, 4)
    first = np.eye(4)[windows.argmax(axis=1)]
    np.testing.assert_array_equal(found, np.repeat(first[None], 3, axis=0))


@pytest.mark.parametrize("size", [(2, 2), (3, 2), (2, 3), (5, 7)])
def test_what_no_window_covers_is_zero(size: tuple[int, int]) -> None:
    x = np.random.default_rng(0).uniform(1, 2, (1, 3, *size))
    graph, gradient = differentiated(["pool"], {})
    found = evaluated(graph, gradient, x)
    assert found.shape == x.shape
    covered = tuple(2 * (side // 2) for side in size)
    assert not found[:, :, covered[0] :].any()
    assert not found[:, :, :, covered[1] :].any()
    assert (np.count_nonzero(found, axis=(2, 3)) == covered[0] * covered[1] // 4).all()


@pytest.mark.parametrize("rectified", [False, True])
@pytest.mark.parametrize(("pad", "ceil"), [(0, 0), (0, 1), (1, 0), (1, 1)])
@pytest.mark.parametrize("size", [(7, 9), (8, 8), (8, 11), (9, 10), (3, 3), (4, 5)])
@pytest.mark.parametrize("lowering", ["fast", "int8"])
def test_windows_that_overlap(size: tuple[int, int], pad: int, ceil: int, rectified: bool, lowering: str) -> None:
    """Against torch, with a seed of any sign, on values in halves, which tie; zeros pad where a ReLU is before only."""
    rng = np.random.default_rng(0)
    x = np.round(2 * rng.standard_normal((2, CHANNELS, *size))) / 2
    image = torch.tensor(x, requires_grad=True)
    value = image.relu() if rectified else image
    pooled = torch.nn.functional.max_pool2d(value, 3, 2, pad, ceil_mode=bool(ceil))
    given = rng.standard_normal(pooled.shape)
    (wanted,) = torch.autograd.grad(pooled, image, torch.tensor(given))

    infos = [helper.make_tensor_value_info(name, TensorProto.DOUBLE, ["N", CHANNELS, h, w])
             for name, h, w in (("x", "H", "W"), ("y", "h", "w"), ("given", "h", "w"))]  # fmt: skip
    nodes = [helper.make_node("Relu", ["x"], ["r"], name="r")] if rectified else []
    nodes.append(helper.make_node("MaxPool", ["r" if rectified else "x"], ["y"], name="y", kernel_shape=[3, 3],
                                  strides=[2, 2], pads=[pad] * 4, ceil_mode=ceil))  # fmt: skip
    model = helper.make_model(helper.make_graph(nodes, "g", infos[:1], infos[1:2]), ir_version=8,
                              opset_imports=[helper.make_opsetid("", 17)])  # fmt: skip
    graph = Graph(model)
    graph.model.graph.input.append(infos[2])
    gradient = with_gradient(graph, "y", "x", "given", lowering)
    assert any(node.op_type == "DepthToSpace" for node in graph.nodes) == bool((pad or ceil) and not rectified)
    with np.errstate(over="ignore"):  # the general form pads with the lowest number there is
        found = evaluated(graph, gradient, x, given=given)
    np.testing.assert_allclose(found, wanted.numpy(), atol=1e-12)


def test_mistakes_with_windows_that_overlap_are_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last of those that tie, a shift to the wrong side, a seed that is not cleared under padding."""
    right, shifted = pools._beats, pools._shifted
    changes = [
        ("_beats", lambda *args: right(*args[:-2], args[-1], args[-2])),
        ("_shifted", lambda site, piece, axis, by, role: shifted(site, piece, axis, 1 - by, role)),
    ]
    for name, wrong in changes:
        with monkeypatch.context() as patch:
            patch.setattr(pools, name, wrong)
            with pytest.raises(AssertionError):
                test_windows_that_overlap((8, 11), 0, 0, False, "int8")
    with monkeypatch.context() as patch:
        patch.setattr(common, "step", lambda site, y, _: site.op("HardSigmoid", y, alpha=0.0, beta=1.0))
        with pytest.raises(AssertionError):
            test_windows_that_overlap((8, 11), 1, 0, True, "int8")


def test_a_mistake_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """The two rows swapped, the last place to tie, a seed that is not cleared: each fails one of the tests above."""
    right = pools.right_wins
    with monkeypatch.context() as patch:
        patch.setattr(pools, "right_wins", lambda site, row: right(site, 1 - row))
        with pytest.raises(AssertionError):
            test_exact_in_float64("one pool", (3, 3), (13, 17))
    with monkeypatch.context() as patch:
        patch.setattr(pools, "right_wins", lambda site, row: _not_left(site, row))
        with pytest.raises(AssertionError):
            test_a_tie_goes_to_the_first_in_raster_order()
    with monkeypatch.context() as patch:
        patch.setattr(common, "step", lambda site, y, _: site.op("HardSigmoid", y, alpha=0.0, beta=1.0))
        with pytest.raises(AssertionError):
            test_a_seed_of_any_sign(["conv1", "relu", "pool"])


def _not_left(site: Site, row: int) -> str:
    """[right >= left]: of a tie, the right place."""
    kernel = np.zeros((2, 2))
    kernel[row] = 1, -1
    left = depthwise.step(site, site.like, kernel, [2, 2], f"left_wins_{row}")
    return site.own("Complement", left, role=f"right_wins_or_ties_{row}")
