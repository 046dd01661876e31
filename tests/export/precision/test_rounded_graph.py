"""A graph in 8 bits: what is rounded, that all readers get it rounded, and that masks stay exact."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from onnx import TensorProto, numpy_helper

from elf_export.dialect import is_own
from elf_export.graph.graph import Graph, attributes
from elf_export.precision.int8.scheme import WEIGHT_LEVELS

from .rounded_networks import Network, complements_in, inside_of, rounded_values, steps_in, with_values


def test_all_readers_of_a_rounded_value_get_the_rounded_one(network: Network) -> None:
    """Nothing but its QuantizeLinear reads what is rounded; or nothing but convolutions reads it rounded."""
    _, lowered, _ = network
    readers = Graph(lowered).consumers()
    rounded = rounded_values(lowered)
    assert len(rounded) > 4

    def behind(name: str) -> set[str]:
        passed = {"QuantizeLinear", "DequantizeLinear", "Gather"}
        found: set[str] = set()
        for node in readers[name]:
            rests = node.output[0].endswith(("/rest", "/with_rest_q"))
            found |= behind(node.output[0]) if rests or node.op_type in passed else {node.op_type}
        return found

    for name in inside_of(lowered):
        quantized = next(node for node in readers[name] if node.op_type == "QuantizeLinear")
        assert behind(quantized.output[0]) == {"Conv"}, name


def test_every_convolution_is_in_integers(network: Network) -> None:
    model, lowered, _ = network
    graph = Graph(lowered)
    makers = graph.producers()
    convolutions = [node for node in graph.nodes if node.op_type == "Conv"]
    assert len(convolutions) >= sum(node.op_type == "Conv" for node in model.graph.node)
    for node in convolutions:
        depthwise = attributes(node).get("group", 1) > 1
        if depthwise and (node.input[0] not in makers or makers[node.input[0]].op_type != "DequantizeLinear"):
            continue  # so few multiplications are not worth rounding for
        if node.name.endswith(("/d", "/pull")):
            continue  # sums over channels
        assert {makers[name].op_type for name in node.input} == {"DequantizeLinear"}, node.name
        assert graph.shape(node.input[1])[1] % 4 == 0 or attributes(node).get("group", 1) > 1, node.name
    for tensor in lowered.graph.initializer:
        if tensor.data_type == TensorProto.INT8:
            assert np.abs(numpy_helper.to_array(tensor).astype(int)).max() <= WEIGHT_LEVELS


def test_masks_are_exact(network: Network) -> None:
    """0 or 1, and where d, the difference of the two rounded values, is positive."""
    model, lowered, x = network
    graph, made = Graph(model), {node.name for node in lowered.graph.node}
    makers = graph.producers()
    masks = [node for node in graph.nodes if is_own(node) and f"{node.output[0]}/q" in made]
    steps = [node for node in masks if node.input[0] in steps_in(model)]
    rooms = [node for node in masks if is_own(node, "Between")]
    signs = [node for node in masks if is_own(node, "Step") and node not in steps]
    sources = {node.output[0]: makers[node.input[0]].input[0] for node in steps}
    sources |= {node.output[0]: node.input[-1] for node in (*rooms, *signs)}
    if not sources:
        pytest.skip("no ReLU or max-pool of rounded values")
    names = [f"{name}/q" for name in (*sources, *sources.values())]
    found = with_values(lowered, list(dict.fromkeys(names)), x)
    for node in (*steps, *rooms, *signs):
        mask, source = node.output[0], sources[node.output[0]]
        q = torch.tensor(found[f"{source}/q"].astype(np.float64))
        if node in signs:
            wanted = q > 0
        elif node in rooms:
            assert {0, 255} < set(q.numpy().ravel())
            wanted = (q > 0) & (q < 255)
        else:
            difference = makers[node.input[0]]
            given = attributes(difference)
            kernel = torch.tensor(graph.constant(difference.input[1]).astype(np.float64))
            top, left, bottom, right = given.get("pads", [0] * 4)
            q = torch.nn.functional.pad(q, (left, right, top, bottom))
            form = given.get("strides", 1), 0, given.get("dilations", 1), given["group"]
            wanted = torch.nn.functional.conv2d(q, kernel, None, *form) > 0
        np.testing.assert_array_equal(found[f"{mask}/q"], (1 if node in signs else 255) * wanted.numpy(), err_msg=mask)


@pytest.mark.parametrize("network", ["vgg", "no relu", "overlapping pool", "reaching pool"], indirect=True)
def test_a_mask_s_complement_is_the_mask_s_own_integers(network: Network) -> None:
    model, lowered, x = network
    made = {name for node in lowered.graph.node for name in node.output}
    pairs = [(mask, rest) for mask, rest in complements_in(model).items() if f"{mask}/q" in made]
    assert pairs
    found = with_values(lowered, [f"{name}/rounded" for pair in pairs for name in pair], x)
    for mask, rest in pairs:
        np.testing.assert_allclose(found[f"{rest}/rounded"], 1 - found[f"{mask}/rounded"], rtol=0, atol=1e-6)
        assert f"{rest}/q" not in made


@pytest.mark.parametrize("network", ["depthwise", "vgg"], indirect=True)
def test_phases_are_joined_as_integers(network: Network) -> None:
    """They share a scheme: nothing is rounded again where a gradient's phases are put together."""
    _, lowered, _ = network
    graph = Graph(lowered)
    joins = [node for node in graph.nodes if node.op_type == "Concat" and graph.rank(node.output[0]) == 4]
    joins = [node for node in joins if not node.name.endswith("/with_rest_q")]
    assert joins
    assert all(graph.elem_type(name) == TensorProto.UINT8 for node in joins for name in node.input)
