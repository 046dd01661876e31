"""8-bit convolutions of several groups, beside floats, and of few taps."""

from __future__ import annotations

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper

from elf_export.graph.graph import GraphView
from elf_export.precision.int8.convolve import REST
from elf_export.precision.int8.rewrite import rewrite
from elf_export.precision.int8.scheme import Scheme
from elf_export.precision.int8.speedup import losing
from elf_export.saliency import build_saliency
from export import small_models as small

from .rounded_networks import images, schemes_of, session, with_values
from .test_regions import network_of


def test_a_grouped_convolution_s_magnitude() -> None:
    """The two steps of a magnitude are side by side along the channels, which groups would tell apart wrongly."""
    rng = np.random.default_rng(0)
    kernel = numpy_helper.from_array((rng.standard_normal((8, 4, 3, 3)) / 6).astype(np.float32), "w")
    first = numpy_helper.from_array((rng.standard_normal((8, 8, 3, 3)) / 8).astype(np.float32), "first")
    nodes = [
        helper.make_node("Conv", ["x", "first"], ["a"], name="a", pads=[1] * 4),
        helper.make_node("Conv", ["a", "w"], ["y"], name="y", group=2, pads=[1] * 4),
        helper.make_node("Abs", ["y"], ["magnitude"], name="magnitude"),
    ]
    infos = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["N", 8, "H", "W"]) for name in ("x", "magnitude")]
    graph = helper.make_graph(nodes, "g", infos[:1], infos[1:], [first, kernel])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    x = rng.standard_normal((1, 8, 20, 20)).astype(np.float32)
    lowered, origins = rewrite(GraphView(model), schemes_of(model, x))
    assert set(origins.values()) == {"a", "y"}
    (found,), (wanted,) = (session(m).run(None, {"x": x}) for m in (lowered, model))
    for a, b in zip(found[0], wanted[0], strict=True):
        assert np.corrcoef(a.ravel(), b.ravel())[0, 1] > 0.99


def test_a_convolution_in_floats_between_two_in_integers() -> None:
    """One that 8 bits are not worth for, whose input is rounded and whose result is: it is in no region."""
    chain = [("Conv", 32, 3), ("Relu", 32, 0), ("Conv", 16, 3), ("Relu", 16, 0), ("Conv", 16, 1), ("Conv", 32, 3)]
    model, x = network_of([*chain, ("Relu", 32, 0), ("Sin", 32, 0)]), images((24, 32), 1)
    lowered, origins = rewrite(GraphView(model), schemes_of(model, x))
    assert "v4" not in origins.values()
    assert any(node.name == "v4" and node.input[1] == "v4_w" for node in lowered.graph.node)
    assert losing(lowered, origins, x) <= set(origins.values())


@pytest.mark.parametrize("group", [1, 24])
@pytest.mark.parametrize(("size", "stride", "pad"), [(3, 2, 2), (2, 2, 1), (3, 3, 2), (5, 4, 4), (3, 2, 1)])
def test_phases_of_every_padding(size: int, stride: int, pad: int, group: int) -> None:
    """A phase's taps may all lie on one side of it: no convolution has a negative padding."""
    rng = np.random.default_rng(0)
    shapes = {"w0": (24, 3, 3, 3), "w1": (24, 24 // group, size, size), "w2": (24, 24, 3, 3)}
    tensors = [
        numpy_helper.from_array((rng.standard_normal(s) * np.sqrt(2 / np.prod(s[1:]))).astype(np.float32), name)
        for name, s in shapes.items()
    ]
    forms = [{"pads": [1] * 4}, {"pads": [pad] * 4, "strides": [stride] * 2, "group": group}, {"pads": [1] * 4}]
    nodes, value = [], "x"
    for i, form in enumerate(forms):
        nodes.append(helper.make_node("Conv", [value, f"w{i}"], [f"c{i}"], name=f"c{i}", **form))
        nodes.append(helper.make_node("Relu", [f"c{i}"], [f"r{i}"], name=f"r{i}"))
        value = f"r{i}"
    image = helper.make_tensor_value_info("x", TensorProto.FLOAT, ["N", 3, "H", "W"])
    output = helper.make_tensor_value_info(value, TensorProto.FLOAT, None)
    graph = helper.make_graph(nodes, "g", [image], [output], tensors)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    floats, x = build_saliency(model, value, [], "x", lowering="int8", masks=True), images((26, 31))
    lowered, origins = rewrite(GraphView(floats), schemes_of(floats, x))
    assert sum(name.startswith("adj/c1/dx_") for name in origins) == stride**2
    (found,), (wanted,) = (session(m).run(None, {"x": x}) for m in (lowered, floats))
    assert np.corrcoef(found.ravel(), wanted.ravel())[0, 1] > 0.97


def test_a_soft_image_s_differences_are_below_a_step() -> None:
    """A ramp of a tenth of a step a pixel: without the rest of the rounding its differences are mostly zero."""
    kernel = np.zeros((16, 3, 3, 3), np.float32)
    kernel[:, 0, 1, 0], kernel[:, 0, 1, 2] = -1, 1
    tensors = {"w": kernel}
    model = small.written("c = Conv<pads = [1, 1, 1, 1]>(x, w)  y = Sin(c)", tensors, [1, 3, 8, 64])
    scheme = Scheme(1.0, 128)
    lowered, _ = rewrite(GraphView(model), {"x": scheme})
    x = np.broadcast_to(np.arange(64, dtype=np.float32) / 10, (1, 3, 8, 64)).copy()
    found = with_values(lowered, ["c"], x)["c"][:, :, 1:-1, 1:-1]
    np.testing.assert_allclose(found, 0.2, atol=2.5 / REST)
    assert abs(found.mean() - 0.2) < 0.02
