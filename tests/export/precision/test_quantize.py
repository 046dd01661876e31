"""8-bit integers: what is rounded, how finely, that masks stay exact, and what ONNX Runtime makes of the graph."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from pathlib import Path

import cv2
import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator

from elf_export import ExportError
from elf_export.calibration import calibration_set
from elf_export.checks.float64 import in_double
from elf_export.graph.graph import Graph, GraphView, attributes
from elf_export.graph.passes import cut
from elf_export.precision.int8 import quantize
from elf_export.precision.int8.candidates import candidates
from elf_export.precision.int8.convolve import FINE
from elf_export.precision.int8.rewrite import rewrite
from elf_export.precision.int8.scheme import LEVELS, SHARES, WEIGHT_LEVELS, Scheme, fitted, reaching, weights
from elf_export.precision.int8.speedup import losing
from elf_export.saliency import build_saliency
from elf_export.sources.forward import NETWORK_INPUT
from elf_export.sources.networks import get_network
from elf_runtime import InputSpec
from export.exported import Exported
from helpers import textured
from seeded import LRN

Values = dict[str, np.ndarray]
ODD = 13, 19


# -- schemes ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("outlier", [1.0, 200.0])
def test_the_fitted_scheme_loses_least(signed: bool, outlier: float) -> None:
    """Against 100 clipping ranges of uint8 codes, written out; zero is exact and never negative wastes no level."""
    rng = np.random.default_rng(0)
    x = rng.laplace(size=300_000).astype(np.float32)
    x[0] = outlier
    x = x if signed else np.abs(x)
    scheme = fitted(x)
    assert scheme.zero == (128 if signed else 0)
    assert scheme.scale == np.float32(scheme.scale)

    def loss(scale: float) -> float:
        low, high = (-128, 127) if signed else (0, 255)
        codes = np.minimum(np.maximum(np.round(x.astype(np.float64) / scale), low), high)
        return float(((codes * scale - x) ** 2).sum())

    top = np.abs(x).max() / (127 if signed else 255)
    best = min(loss(top * share) for share in np.linspace(0.1, 1, 100))
    assert loss(scheme.scale) <= 1.02 * best
    np.testing.assert_allclose(((scheme.rounded(x) - x) ** 2).sum(), loss(scheme.scale))
    assert scheme.rounded(np.zeros(1)) == 0
    assert scheme.scale < 0.9 * top, "the largest value costs all others their steps"


@pytest.mark.parametrize("values", [np.zeros(4, np.float32), np.zeros(0, np.float32)])
def test_nothing_to_fit(values: np.ndarray) -> None:
    assert fitted(values) == Scheme(1 / 255)


def test_weights_are_rounded_channel_by_channel() -> None:
    rng = np.random.default_rng(0)
    kernel = rng.standard_normal((5, 4, 3, 3)) * np.geomspace(1e-4, 1e3, 5)[:, None, None, None]
    kernel[2] = 0
    q, scales = weights(kernel)
    assert (q.dtype, scales.dtype) == (np.int8, np.float32)
    assert (scales > 0).all()
    error = np.abs(q * scales[:, None, None, None].astype(np.float64) - kernel)
    assert (error.max(axis=(1, 2, 3)) <= 0.5001 * scales).all()
    tops = np.abs(q).max(axis=(1, 2, 3))
    np.testing.assert_array_equal(tops, [63, 63, 0, 63, 63])


def test_two_products_fit_16_bits() -> None:
    """What x86 processors without VNNI add up in int16 (VPMADDUBSW): two of uint8 times int8."""
    assert 2 * LEVELS * WEIGHT_LEVELS < 2**15
    assert 2 * LEVELS * (2 * WEIGHT_LEVELS) >= 2**15  # no bit is given away
    assert max(SHARES) == 1.0


@pytest.mark.parametrize("top", [6.0, 1.0, 0.1, 20.0, *np.random.default_rng(0).uniform(0, 9, 40).astype(np.float32)])
def test_the_highest_level_is_the_bound_itself(top: float) -> None:
    scale = np.float32(reaching(float(np.float32(top))).scale)
    assert scale * np.float32(255) == np.float32(top)


# -- small networks, and what they are in 8 bits ----------------------------------------------------------------

Layers = list[str]
NETWORKS: dict[str, Layers] = {
    "convolutions": ["conv3", "relu", "conv3", "relu"],
    "vgg": ["conv3", "relu", "conv3", "relu", "pool", "conv3", "relu"],
    "pool last": ["conv3", "relu", "conv3", "relu", "pool"],
    "two pools": ["conv3", "relu", "pool", "conv3", "relu", "pool", "conv3"],
    "no relu": ["conv3", "conv3", "pool"],
    "strided": ["stride", "relu", "conv3", "relu"],
    "overlapping pool": ["conv3", "relu", "pool3", "conv3", "relu"],
    "padded": ["conv3", "pad", "conv3", "relu", "conv3"],
    "residual": ["conv3", "relu", "shortcut", "relu", "conv3", "relu"],
    "clipped": ["conv3", "clip", "conv3", "clip"],
    "normalized": ["conv3", "relu", "lrn", "pool3", "conv3", "relu"],
    "average": ["conv3", "relu", "average", "conv3", "relu"],
    "strided inside": ["conv3", "relu", "stride", "relu", "conv3", "relu"],
    "depthwise": ["conv3", "clip", "each stride", "clip", "conv3"],
    "depthwise first": ["each", "conv3", "relu", "conv3", "relu"],
    "padded pool": ["stride", "relu", "pool3 padded", "conv3", "relu"],
    "reaching pool": ["conv3", "relu", "pool3 ceil", "conv3", "relu"],
}
WIDTH = 8


def forward(layers: Layers, seed: int = 0) -> onnx.ModelProto:
    """x (N, 3, H, W) through the layers, seeded weights with biases; the values are v0, v1, ..."""
    rng = np.random.default_rng(seed)
    nodes, tensors, value, width = [], [], "x", 3
    for index, kind in enumerate(layers):
        out = f"v{index}"
        if kind in ("conv3", "stride", "shortcut", "each", "each stride"):
            per_group = 1 if kind.startswith("each") else width
            results = width if kind == "each" else WIDTH
            kernel = rng.standard_normal((results, per_group, 3, 3)) * np.sqrt(2 / (9 * per_group))
            bias = 0.2 * rng.standard_normal(results)
            tensors += [numpy_helper.from_array(kernel.astype(np.float32), f"{out}_w"),
                        numpy_helper.from_array(bias.astype(np.float32), f"{out}_b")]  # fmt: skip
            strides = [2, 2] if kind.endswith("stride") else [1, 1]
            made = f"{out}_conv" if kind == "shortcut" else out
            nodes.append(helper.make_node("Conv", [value, f"{out}_w", f"{out}_b"], [made], name=made,
                                          pads=[1] * 4, strides=strides, group=width // per_group))  # fmt: skip
            if kind == "shortcut":
                nodes.append(helper.make_node("Add", [made, value], [out], name=out))
            width = results
        elif kind == "relu":
            nodes.append(helper.make_node("Relu", [value], [out], name=out))
        elif kind == "clip":
            tensors += [numpy_helper.from_array(np.float32(v), f"{out}_{w}") for w, v in (("low", 0), ("high", 1))]
            nodes.append(helper.make_node("Clip", [value, f"{out}_low", f"{out}_high"], [out], name=out))
        elif kind == "pad":
            tensors.append(numpy_helper.from_array(np.array([0, 0, 1, 2, 0, 0, 2, 1]), f"{out}_pads"))
            nodes.append(helper.make_node("Pad", [value, f"{out}_pads"], [out], name=out))
        elif kind == "lrn":
            nodes.append(helper.make_node("LRN", [value], [out], name=out, size=3, alpha=0.5, beta=0.75))
        elif kind == "average":
            nodes.append(helper.make_node("AveragePool", [value], [out], name=out, kernel_shape=[2, 2], strides=[2, 2]))
        else:
            size = 3 if kind.startswith("pool3") else 2
            nodes.append(helper.make_node("MaxPool", [value], [out], name=out, kernel_shape=[size] * 2, strides=[2, 2],
                                          pads=[int("padded" in kind)] * 4, ceil_mode=int("ceil" in kind)))  # fmt: skip
        value = out
    image = helper.make_tensor_value_info("x", TensorProto.FLOAT, ["N", 3, "H", "W"])
    output = helper.make_tensor_value_info(value, TensorProto.FLOAT, None)
    graph = helper.make_graph(nodes, "net", [image], [output], tensors)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def saliency(layers: Layers, channels_last: bool = True) -> onnx.ModelProto:
    model = forward(layers)
    return build_saliency(model, f"v{len(layers) - 1}", [], "x", channels_last=channels_last)


def images(size: tuple[int, int] = ODD, count: int = 2) -> np.ndarray:
    """Standard normal, with flat regions, where values tie."""
    rng = np.random.default_rng(1)
    x = rng.standard_normal((count, 3, *size)).astype(np.float32)
    x[-1, :, : size[0] // 2] = 0.5
    return x


def stepwise(
    model: onnx.ModelProto,
    x: np.ndarray,
    roundings: Mapping[str, Scheme] | None = None,
    inside: Collection[str] = (),
    steps: Collection[str] = (),
    codes: Mapping[str, np.ndarray] | None = None,
) -> tuple[Values, Values]:
    """Every value of the model in float64, node by node, and the integers of those in `roundings`.

    What is `inside` is rounded for convolutions alone, except those in `steps`.  Nodes go on from `codes`, integers
    that somebody else found: a difference is then that of one node.
    """
    evaluator = ReferenceEvaluator(in_double(model), new_ops=[LRN])
    values: Values = dict(evaluator.rt_inits_) | {"": None}  # type: ignore[dict-item]
    convolved: Values = {}
    integers: Values = {}

    def store(name: str, value: np.ndarray) -> None:
        scheme = (roundings or {}).get(name)
        exact = value
        if scheme is not None:
            code = np.minimum(np.maximum(np.round(value / scheme.scale) + scheme.zero, 0), 255)
            integers[name] = code
            code = code if codes is None else codes[name]
            # As the operator is specified, in float32: a comparison may depend on the last bit.
            value = (np.float32(code - float(scheme.zero)) * np.float32(scheme.scale)).astype(np.float64)
        convolved[name] = value
        values[name] = exact if name in inside else value

    store("x", x.astype(np.float64))
    for node in evaluator.rt_nodes_:
        first = node.op_type == "Conv" and node.output[0] not in steps
        given = [convolved.get(n, values[n]) if first and i == 0 else values[n] for i, n in enumerate(node.input)]
        for name, value in zip(node.output, node.run(*given), strict=False):
            store(name, value)
    return values, integers


def schemes_of(model: onnx.ModelProto, x: np.ndarray) -> dict[str, Scheme]:
    values, _ = stepwise(model, x)
    return {name: fitted(values[name].astype(np.float32).ravel()) for name in candidates(GraphView(model))}


def session(model: onnx.ModelProto, path: Path | None = None, optimized: bool = True) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    options.intra_op_num_threads = 1
    levels = onnxruntime.GraphOptimizationLevel
    options.graph_optimization_level = levels.ORT_ENABLE_ALL if optimized else levels.ORT_DISABLE_ALL
    if path is not None:
        options.optimized_model_filepath = str(path)
    return onnxruntime.InferenceSession(model.SerializeToString(), options, ["CPUExecutionProvider"])


def with_values(model: onnx.ModelProto, names: list[str], x: np.ndarray) -> Values:
    """What ONNX Runtime computes for the values `names`."""
    part = cut(model, names)
    graph = Graph(part)
    for value in part.graph.output:
        value.CopyFrom(helper.make_tensor_value_info(value.name, graph.elem_type(value.name), None))
    return dict(zip(names, session(part).run(names, {"x": x}), strict=True))


def rounded_values(model: onnx.ModelProto) -> dict[str, Scheme]:
    """Value -> how the graph's QuantizeLinear nodes round it."""
    graph = Graph(model)
    found = {}
    for node in graph.nodes:
        if node.op_type == "QuantizeLinear":
            scale, zero = (graph.constant(name) for name in node.input[1:3])
            found[node.input[0]] = Scheme(float(scale), int(zero))
    return found


@pytest.fixture(params=NETWORKS)
def network(request: pytest.FixtureRequest) -> tuple[onnx.ModelProto, onnx.ModelProto, np.ndarray]:
    """A float saliency graph, its 8-bit form, and images."""
    model, x = saliency(NETWORKS[request.param]), images()
    lowered, _ = rewrite(GraphView(model), schemes_of(model, x))
    onnx.checker.check_model(lowered, full_check=True)
    return model, lowered, x


Network = tuple[onnx.ModelProto, onnx.ModelProto, np.ndarray]


def inside_of(lowered: onnx.ModelProto) -> set[str]:
    """Rounded values that other nodes read unrounded."""
    readers = Graph(lowered).consumers()
    return {v for v in rounded_values(lowered) if any(n.op_type != "QuantizeLinear" for n in readers[v])}


def test_all_readers_of_a_rounded_value_get_the_rounded_one(network: Network) -> None:
    """Nothing but its QuantizeLinear reads what is rounded; or nothing but convolutions reads it rounded."""
    _, lowered, _ = network
    readers = Graph(lowered).consumers()
    rounded = rounded_values(lowered)
    assert len(rounded) > 4

    def behind(name: str) -> set[str]:
        passed = {"QuantizeLinear", "DequantizeLinear", "Gather"}
        nodes = readers[name]
        return set().union(*(behind(n.output[0]) if n.op_type in passed else {n.op_type} for n in nodes))

    for name in inside_of(lowered):
        quantized = next(node for node in readers[name] if node.op_type == "QuantizeLinear")
        assert behind(quantized.output[0]) == {"Conv"}, name


def test_every_convolution_is_in_integers(network: Network) -> None:
    model, lowered, _ = network
    graph = Graph(lowered)
    makers = graph.producers()
    convolutions = [node for node in graph.nodes if node.op_type == "Conv"]
    assert len(convolutions) >= sum(node.op_type == "Conv" for node in model.graph.node) - len(complements_in(model))
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
    masks = [node for node in graph.nodes if node.op_type == "HardSigmoid" and f"{node.output[0]}/q" in made]
    steps = [node for node in masks if makers[node.input[0]].name.endswith("_difference")]
    rooms = [node for node in masks if makers[node.input[0]].name.endswith("/room")]
    signs = [node for node in masks if node not in steps and node not in rooms]
    sources = {n.output[0]: makers[n.input[0]].input[0] for n in (*steps, *rooms)}
    sources |= {n.output[0]: n.input[0] for n in signs}
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


def complements_in(model: onnx.ModelProto) -> dict[str, str]:
    """Mask -> one minus it, by a convolution of all channels alike."""
    graph = Graph(model)
    found = [node for node in graph.nodes if node.op_type == "Conv" and len(node.input) == 3]
    constants = {node.output[0]: [graph.constant(name) for name in node.input[1:]] for node in found}
    return {
        node.input[0]: node.output[0]
        for node in found
        if all(np.all(value == wanted) for value, wanted in zip(constants[node.output[0]], (-1, 1), strict=True))
    }


def steps_in(model: onnx.ModelProto) -> set[str]:
    """The differences that a HardSigmoid makes masks of."""
    found = {node.input[0] for node in model.graph.node if node.op_type == "HardSigmoid"}
    return {name for name in found if name.endswith("_difference")}


def with_rounded_weights(model: onnx.ModelProto, lowered: onnx.ModelProto) -> onnx.ModelProto:
    """Every Conv's kernel in 127 levels a channel, a ConvTranspose's in as many for each channel of each phase.

    Those that stay in floats in `lowered` are left alone.
    """
    result, graph, made = onnx.ModelProto(), Graph(model), Graph(lowered)
    steps = steps_in(model) | {n.output[0] for n in made.nodes if n.op_type == "Conv" and made.is_constant(n.input[1])}
    result.CopyFrom(model)
    for node in result.graph.node:
        if node.op_type == "Conv" and node.output[0] not in steps:
            rounded = in_127_levels(graph.constant(node.input[1]).astype(np.float64))
        elif node.op_type == "ConvTranspose":
            rounded, (top, left) = graph.constant(node.input[1]).astype(np.float64), attributes(node)["pads"][:2]
            outputs = 0 if attributes(node).get("group", 1) > 1 else 1
            for a, b in np.ndindex(2, 2):
                part = rounded[:, :, (a + top) % 2 :: 2, (b + left) % 2 :: 2]
                part[:] = in_127_levels(part.swapaxes(0, outputs)).swapaxes(0, outputs)
        if node.op_type == "ConvTranspose" or (node.op_type == "Conv" and node.output[0] not in steps):
            node.input[1] = f"{node.output[0]}/127"
            result.graph.initializer.append(numpy_helper.from_array(rounded.astype(np.float32), node.input[1]))
    return result


def in_127_levels(kernel: np.ndarray) -> np.ndarray:
    largest = np.abs(kernel).max(axis=(1, 2, 3), keepdims=True)
    step = np.where(largest > 0, largest, 1) / 63
    return np.asarray(np.round(kernel / step) * step)


def test_it_computes_what_rounding_each_value_gives(network: Network) -> None:
    """Against the float graph in float64, its weights and values rounded where the 8-bit graph rounds.

    ONNX Runtime scales int32 sums by a float32: some values near a tie of two levels fall on the other side.
    """
    model, lowered, x = network
    made, forward_or_adjoint = Graph(lowered).producers(), Graph(model).producers()
    roundings = {
        name: scheme
        for name, scheme in rounded_values(lowered).items()
        if (name == "x" or name in forward_or_adjoint) and f"{name}/q" in made
    }
    assert len(roundings) >= 4
    found = with_values(lowered, [f"{name}/q" for name in roundings], x)
    codes = {name: found[f"{name}/q"] for name in roundings}
    values, integers = stepwise(
        with_rounded_weights(model, lowered), x, roundings, inside_of(lowered), steps_in(model), codes
    )
    for name in roundings:
        off = np.abs(codes[name] - integers[name])
        assert off.max() <= 1, name
        assert (off > 0).mean() <= 0.01, name
    (saliency,) = session(lowered).run(None, {"x": x})
    (last,) = (node.input[0] for node in model.graph.node if node.op_type == "Abs")
    wanted = values["saliency"]
    ends = (f"{last}/both", f"{last}_full/phases")
    both = next((scheme for name, scheme in rounded_values(lowered).items() if name in ends), None)
    if both is not None:
        wanted = in_two_steps(values[last], both).mean(axis=1)
    off = np.abs(saliency - wanted)
    assert np.median(off) <= 1e-5 * wanted.max()
    assert off.max() <= (1.01 * both.scale if both is not None else 1e-5 * wanted.max())
    (floats,) = session(model).run(None, {"x": x})
    assert np.corrcoef(saliency.ravel(), floats.ravel())[0, 1] > 0.9


def in_two_steps(y: np.ndarray, scheme: Scheme) -> np.ndarray:
    """|y| in sixteenths of the scheme's steps, below a sixteenth of its range; in whole steps above."""
    fine = np.abs(scheme.rounded(FINE * y))
    return np.where(fine < 126.5 * scheme.scale, fine / FINE, np.abs(scheme.rounded(y)))


def straight_through(value: torch.Tensor, scheme: Scheme | None, rectified: bool) -> torch.Tensor:
    """The value rounded; the gradient of a ReLU's is cleared where the rounded one is zero."""
    if scheme is None:
        return value
    rounded = torch.tensor(scheme.rounded(value.detach().numpy()))
    passed = value * (rounded > 0) if rectified else value
    return passed + (rounded - passed).detach()


@pytest.mark.parametrize("name", ["convolutions", "vgg", "two pools", "overlapping pool", "normalized", "average"])
@pytest.mark.parametrize("channels_last", [True, False])
def test_it_is_the_gradient_of_the_rounded_network(name: str, channels_last: bool) -> None:
    """Only what comes before the last convolution is rounded here, so that the gradient is in floats; then
    torch.autograd, to which rounding is the identity, gives the same."""
    layers, x = NETWORKS[name], images()
    model = saliency(layers, channels_last)
    last = len(layers) - 1 - layers[::-1].index("conv3")
    before_it = {"x", *(f"v{index}" for index in range(last))}
    schemes = {v: s for v, s in schemes_of(model, x).items() if v in before_it}
    lowered, _ = rewrite(GraphView(model), schemes)
    roundings, inside = rounded_values(lowered), inside_of(lowered)
    graph = Graph(forward(layers))
    image = torch.tensor(x.astype(np.float64), requires_grad=True)
    value, scheme = image, roundings["x"]
    for index, kind in enumerate(layers):
        out = f"v{index}"
        before = f"v{index - 1}" if index else "x"
        if kind == "conv3":
            kernel, bias = (torch.tensor(graph.constant(f"{out}_{w}").astype(np.float64)) for w in "wb")
            alone = before in inside or before == "x"
            scheme = roundings[before] if alone else scheme
            source = straight_through(value, scheme, False) if alone else value
            exact = torch.nn.functional.conv2d(source, kernel, bias, padding=1)
            q = torch.tensor(in_127_levels(kernel.numpy()))
            unit = scheme.scale * kernel.abs().amax(dim=(1, 2, 3)) / 63  # biases are whole numbers of it
            result = torch.nn.functional.conv2d(source, q, torch.round(bias / unit) * unit, padding=1)
            value = exact + (result - exact).detach()
        elif kind == "relu":
            value = value.relu()
        elif kind == "lrn":
            value = torch.nn.functional.local_response_norm(value, 3, 0.5, 0.75, 1.0)
        elif kind == "average":
            value = torch.nn.functional.avg_pool2d(value, 2)
        else:
            value = torch.nn.functional.max_pool2d(value, int(kind[4:] or 2), 2)
        if out in roundings and out not in inside:
            scheme = roundings[out]
            value = straight_through(value, scheme, kind == "relu")
    (gradient,) = torch.autograd.grad(value, image, value.detach())
    wanted = gradient.abs().mean(dim=1).numpy()
    (found,) = session(lowered, optimized=False).run(None, {"x": x})
    error = np.abs(found - wanted) / wanted.max()
    # float32 sums near a tie of two levels fall on the other side of it than float64 ones.
    assert np.median(error) <= 1e-6
    assert (error > 1e-3).mean() <= 0.03


# -- the last gradient, and what ONNX Runtime makes of the graphs ------------------------------------------------


def test_small_gradients_are_kept_more_finely() -> None:
    """|y| over a fine ramp: it never falls, and is off by half a fine step, half a coarse one beyond."""
    step = 1.0 / 255
    kernel = np.zeros((3, 4, 3, 3), np.float32)
    kernel[:, 0, 1, 1], kernel[:, 1, 1, 1] = 1.0, 1.0 / 63  # whole numbers of their step
    nodes = [
        helper.make_node("Conv", ["x", "w"], ["y"], name="y", pads=[1] * 4),
        helper.make_node("Abs", ["y"], ["magnitude"], name="magnitude"),
    ]
    image = helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 4, 1, "W"])
    output = helper.make_tensor_value_info("magnitude", TensorProto.FLOAT, [1, 3, 1, "W"])
    graph = helper.make_graph(nodes, "g", [image], [output], [numpy_helper.from_array(kernel, "w")])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    scheme = Scheme(1.0 / 127, 128)
    lowered, _ = rewrite(GraphView(model), {"x": Scheme(step), "y": scheme})
    first, second = np.divmod(np.arange(256 * 63), 63)
    x = np.zeros((1, 4, 1, len(first)), np.float32)
    x[0, 0, 0], x[0, 1, 0] = first * np.float32(step), second * np.float32(step)
    for optimized in (True, False):
        (found,) = session(lowered, optimized=optimized).run(None, {"x": x})
        exact = (first + second / 63) * step
        for channel in found[0, :, 0]:
            assert (np.diff(channel) >= 0).all()
            fine = exact < 126 / 127 / FINE
            assert 900 < fine.sum() < 1100
            assert np.abs(channel - exact)[fine].max() <= 0.51 * scheme.scale / FINE
            assert np.abs(channel - exact)[exact <= 1].max() <= 0.51 * scheme.scale
            assert (channel[exact > 1] == 1).all()


@pytest.fixture(scope="module")
def vgg8(vgg: Exported, tmp_path_factory: pytest.TempPathFactory) -> tuple[onnx.ModelProto, onnx.ModelProto]:
    """ELF-VGG pool2, which describes by itself too, in float32 and in 8 bits, fitted to two pictures."""
    network, folder = get_network("vgg"), tmp_path_factory.mktemp("pictures")
    for seed in range(2):
        cv2.imwrite(str(folder / f"{seed}.png"), textured(96, 128, seed))
    floats = build_saliency(vgg.forward, "pool2", [], NETWORK_INPUT, network.preprocessing, channels_last=True)
    return floats, quantize(floats, calibration_set(folder), InputSpec(), 1.0)


def test_onnx_runtime_convolves_integers_all_the_way(
    vgg8: tuple[onnx.ModelProto, onnx.ModelProto], tmp_path: Path
) -> None:
    """Every convolution is fused, none is left in floats, and between them no value becomes a float."""
    _, lowered = vgg8
    session(lowered, tmp_path / "optimized.onnx")
    nodes = onnx.load(tmp_path / "optimized.onnx").graph.node
    kinds = Counter(node.op_type for node in nodes)
    assert kinds["QLinearConv"] == sum(node.op_type == "Conv" for node in lowered.graph.node)
    network = {node.op_type for node in nodes if not node.name.startswith("pre/")}
    assert not network & {"Conv", "FusedConv", "ConvTranspose", "MaxPool", "HardSigmoid", "Sign"}
    assert kinds["QuantizeLinear"] == 1  # the image
    readers = Graph(onnx.load(tmp_path / "optimized.onnx")).consumers()
    floats = [node.output[0] for node in nodes if node.op_type == "DequantizeLinear"]
    assert len(floats) == 2  # the last gradient in two steps
    assert {reader.op_type for value in floats for reader in readers[value]} == {"Abs"}


@pytest.mark.parametrize("size", [(64, 80), (67, 81), (33, 34)])
def test_sizes_and_batches(vgg8: tuple[onnx.ModelProto, onnx.ModelProto], size: tuple[int, int]) -> None:
    floats, lowered = vgg8
    pixels = np.stack([textured(*size, seed) for seed in (5, 6)]).astype(np.float32)
    (both,) = session(lowered).run(None, {"image": pixels})
    (wanted,) = session(floats).run(None, {"image": pixels})
    assert both.shape == (2, *size)
    for image, together, exact in zip(pixels, both, wanted, strict=True):
        (alone,) = session(lowered).run(None, {"image": image[None]})
        np.testing.assert_array_equal(alone[0], together)
        assert np.corrcoef(together.ravel(), exact.ravel())[0, 1] > 0.9


def test_an_output_keeps_its_name_and_its_values() -> None:
    """A descriptor that the 8-bit path makes is rounded where convolutions read it, and not as an output."""
    model, x = forward(["conv3", "relu", "conv3", "relu"]), images()
    both = build_saliency(model, "v3", ["v1", "v3"], "x", channels_last=True)
    lowered, _ = rewrite(GraphView(both), schemes_of(both, x))
    names = [value.name for value in both.graph.output]
    assert [value.name for value in lowered.graph.output] == names == ["saliency", "descriptors_v1", "descriptors_v3"]
    exact = dict(zip(names, session(both).run(None, {"x": x}), strict=True))
    found = dict(zip(names, session(lowered).run(None, {"x": x}), strict=True))
    for name in names[1:]:
        assert found[name].shape == exact[name].shape
        spread = np.abs(found[name] - exact[name]).mean() / np.abs(exact[name]).mean()
        assert spread < 0.05, name


def test_what_is_not_two_dimensional_stays_in_floats() -> None:
    kernel = numpy_helper.from_array(np.ones((4, 3, 3), np.float32), "w")
    node = helper.make_node("Conv", ["x", "w"], ["y"], name="y")
    image = helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 3, "W"])
    output = helper.make_tensor_value_info("y", TensorProto.FLOAT, None)
    graph = helper.make_graph([node], "g", [image], [output], [kernel])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    assert candidates(GraphView(model)) == []
    assert [n.op_type for n in rewrite(GraphView(model), {})[0].graph.node] == ["Conv"]


def test_a_clip_reaches_its_bound_whatever_was_seen() -> None:
    """Levels that end below it would let gradients pass where the network saturates."""
    model, x = saliency(NETWORKS["clipped"]), images()
    schemes = schemes_of(model, x) | {"v1": Scheme(0.3 / 255)}
    found = rounded_values(rewrite(GraphView(model), schemes)[0])["v1"]
    assert found == reaching(1.0)
    assert np.float32(found.scale) * np.float32(255) == 1


# -- regions ------------------------------------------------------------------------------------------------------

Chain = list[tuple[str, int, int]]  # operator, channels of its result, size of its kernel


def network_of(chain: Chain) -> onnx.ModelProto:
    """x (N, 3, H, W) through convolutions and element-wise operators, no gradient; the values are v0, v1, ..."""
    nodes, tensors, value, width = [], [], "x", 3
    for index, (kind, results, size) in enumerate(chain):
        out = f"v{index}"
        if kind == "Conv":
            kernel = np.random.default_rng(index).standard_normal((results, width, size, size)) / size
            tensors.append(numpy_helper.from_array(kernel.astype(np.float32), f"{out}_w"))
            nodes.append(helper.make_node("Conv", [value, f"{out}_w"], [out], name=out, pads=[size // 2] * 4))
            width = results
        else:
            nodes.append(helper.make_node(kind, [value], [out], name=out))
        value = out
    image = helper.make_tensor_value_info("x", TensorProto.FLOAT, ["N", 3, "H", "W"])
    output = helper.make_tensor_value_info(value, TensorProto.FLOAT, ["N", width, "H", "W"])
    graph = helper.make_graph(nodes, "net", [image], [output], tensors)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


@pytest.mark.parametrize(
    ("chain", "slow"),
    [
        ([("Conv", 64, 3), ("Relu", 64, 0), ("Conv", 64, 3), ("Sin", 64, 0)], []),
        # An output stays as it is, so what makes it runs in floats; nothing pays for what is before it then.
        ([("Conv", 64, 3), ("Relu", 64, 0), ("Conv", 64, 3)], ["v0", "v2"]),
        # Few multiplications, between values in floats.
        ([("Conv", 8, 3), ("Sin", 8, 0)], ["v0"]),
        # The same beside a region that gains, and as a part of one.
        ([("Conv", 8, 3), ("Sin", 8, 0), ("Conv", 64, 5), ("Conv", 64, 3), ("Sin", 64, 0)], ["v0"]),
        ([("Conv", 8, 3), ("Relu", 8, 0), ("Conv", 64, 5), ("Conv", 64, 3), ("Sin", 64, 0)], []),
    ],
)
def test_regions_that_lose_are_found(chain: Chain, slow: list[str]) -> None:
    model, x = network_of(chain), images((24, 32), 1)
    lowered, origins = rewrite(GraphView(model), schemes_of(model, x))
    assert set(origins.values()) == {f"v{index}" for index, (kind, _, _) in enumerate(chain) if kind == "Conv"}
    assert losing(lowered, origins, x) == set(slow)
    kept, others = rewrite(GraphView(model), schemes_of(model, x), slow)
    assert set(others.values()) == set(origins.values()) - set(slow)
    for name in slow:
        (node,) = (node for node in kept.graph.node if node.name == name)
        assert node == next(node for node in model.graph.node if node.name == name)  # as it was


def test_a_strided_convolution_s_adjoint_pays_by_its_channels() -> None:
    """Few channels do not pay for the interleaving, many do; an image's take as long in floats."""
    for width, results, pays in ((4, 16, False), (256, 16, True), (256, 3, False), (4096, 3, False)):
        rng = np.random.default_rng(0)
        kernel = numpy_helper.from_array(rng.standard_normal((width, results, 3, 3)).astype(np.float32), "w")
        nodes = [
            helper.make_node("Sin", ["x"], ["s"], name="s"),
            helper.make_node("ConvTranspose", ["s", "w"], ["full"], name="full", strides=[2, 2], pads=[1, 1, 0, 0],
                             output_padding=[1, 1]),
            helper.make_node("Slice", ["full", "starts", "ends", "axes"], ["part"], name="part"),
            helper.make_node("Abs", ["part"], ["magnitude"], name="magnitude"),
        ]  # fmt: skip
        bounds = {"starts": [0, 0], "ends": [31, 47], "axes": [2, 3]}
        tensors = [kernel, *(numpy_helper.from_array(np.array(v), name) for name, v in bounds.items())]
        image = helper.make_tensor_value_info("x", TensorProto.FLOAT, ["N", width, 16, 24])
        output = helper.make_tensor_value_info("magnitude", TensorProto.FLOAT, ["N", results, "h", "w"])
        graph = helper.make_graph(nodes, "g", [image], [output], tensors)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        x = rng.standard_normal((1, width, 16, 24)).astype(np.float32)
        schemes = {"s": Scheme(1 / 127, 128), "full": Scheme(0.1, 128)}
        lowered, origins = rewrite(GraphView(model), schemes)
        assert set(origins.values()) == {"full"}
        assert losing(lowered, origins, x) == (set() if pays else {"full"})


def convolution(kernel: np.ndarray, group: int = 1) -> onnx.ModelProto:
    """x -> Conv -> y."""
    node = helper.make_node("Conv", ["x", "w"], ["y"], name="y", group=group)
    image = helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, kernel.shape[1] * group, "H", "W"])
    output = helper.make_tensor_value_info("y", TensorProto.FLOAT, None)
    weights = numpy_helper.from_array(kernel.astype(np.float32), "w")
    graph = helper.make_graph([node], "g", [image], [output], [weights])
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


@pytest.mark.parametrize(
    ("results", "channels", "size", "group", "worth"),
    [(8, 3, 3, 1, True), (64, 1, 11, 1, False), (16, 16, 1, 1, False), (32, 32, 1, 1, True), (64, 64, 3, 64, True)],
)
def test_only_what_gains_is_rounded(results: int, channels: int, size: int, group: int, worth: bool) -> None:
    """One channel is padded to four; a 1x1 kernel between few channels computes little for what it reads."""
    model = convolution(np.random.default_rng(0).standard_normal((results, channels // group, size, size)), group)
    assert candidates(GraphView(model)) == (["x", "y"] if worth else [])
    if not worth:
        with pytest.raises(ExportError, match="int8: 8-bit integers make no convolution of this network faster"):
            quantize(model, calibration_set(), InputSpec(), 1.0)


def test_sums_over_channels_stay_in_floats() -> None:
    """Local response normalisation's, of squares: half of their values would be one level of 256."""
    i, j = np.indices((96, 96))
    band = (abs(i - j) <= 2)[:, :, None, None] * 0.5
    assert candidates(GraphView(convolution(band))) == []
    band[0, 0] = 1.0
    assert candidates(GraphView(convolution(band))) == ["x", "y"]


# -- convolutions of several groups, in floats, and of few taps ----------------------------------------------------


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


@pytest.mark.parametrize("group", [1, 16])
@pytest.mark.parametrize(("size", "stride", "pad"), [(3, 2, 2), (2, 2, 1), (3, 3, 2), (5, 4, 4), (3, 2, 1)])
def test_phases_of_every_padding(size: int, stride: int, pad: int, group: int) -> None:
    """A phase's taps may all lie on one side of it: no convolution has a negative padding."""
    rng = np.random.default_rng(0)
    shapes = {"w0": (16, 3, 3, 3), "w1": (16, 16 // group, size, size), "w2": (16, 16, 3, 3)}
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
    floats, x = build_saliency(model, value, [], "x", channels_last=True), images((26, 31))
    lowered, origins = rewrite(GraphView(floats), schemes_of(floats, x))
    phases = [name for name, origin in origins.items() if name.startswith(f"{origin}/phase")]
    assert len(phases) == stride**2
    (found,), (wanted,) = (session(m).run(None, {"x": x}) for m in (lowered, floats))
    assert np.corrcoef(found.ravel(), wanted.ravel())[0, 1] > 0.97
