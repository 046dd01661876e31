"""A graph in 8 bits computes what rounding each value gives, and the gradient of the rounded network."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from elf_export.graph.graph import Graph, GraphView
from elf_export.precision.int8.convolve import FINE
from elf_export.precision.int8.rewrite import rewrite
from elf_export.precision.int8.scheme import Scheme

from .rounded_networks import (
    NETWORKS,
    Network,
    for_rests,
    forward,
    has_rests,
    images,
    in_127_levels,
    inside_of,
    rounded_values,
    saliency,
    schemes_of,
    session,
    steps_in,
    stepwise,
    with_rest,
    with_rounded_weights,
    with_values,
)


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
    both = rounded_values(lowered).get(f"{last}/both")
    if both is not None:
        wanted = in_two_steps(values[last], both)
        if any(node.op_type == "ConvTranspose" for node in model.graph.node):  # in phases, side by side
            n, _, h, w = wanted.shape
            wanted = wanted.reshape(n, 2, 2, 3, h, w).mean(axis=3).transpose(0, 3, 1, 4, 2).reshape(n, 2 * h, 2 * w)
            wanted = wanted[:, : saliency.shape[1], : saliency.shape[2]]
        else:
            wanted = wanted.mean(axis=1)
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
@pytest.mark.parametrize("lowering", ["int8", "fast"])
def test_it_is_the_gradient_of_the_rounded_network(name: str, lowering: str) -> None:
    """Only what comes before the last convolution is rounded here, so that the gradient is in floats; then
    torch.autograd, to which rounding is the identity, gives the same."""
    layers, x = NETWORKS[name], images()
    model = saliency(layers, lowering)
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
            rests = has_rests(lowered, before)
            exact = torch.nn.functional.conv2d(source, kernel, bias, padding=1)
            q = torch.tensor(in_127_levels(for_rests(kernel.numpy()) if rests else kernel.numpy()))
            unit = scheme.scale * kernel.abs().amax(dim=(1, 2, 3)) / 63  # biases are whole numbers of it
            if rests:
                source = torch.tensor(with_rest(value.detach().numpy(), source.detach().numpy(), scheme))
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
