"""From how many channels on a region of 8-bit nodes is worth it, worked out by hand.

In values of C channels moved once, a convolution of C D multiplications a pixel saves D / 60 and any other node inside
1; an entry costs twice 1, a way out twice 3.
"""

from __future__ import annotations

import numpy as np
import pytest
from onnx import TensorProto, helper

from elf_export.graph.graph import GraphView
from elf_export.precision.int8.candidates import candidates
from elf_export.precision.int8.rewrite import rewrite
from elf_export.precision.int8.scheme import Scheme
from elf_export.precision.int8.speedup import losing
from export import small_models as small

SIGNED, POSITIVE = Scheme(1 / 127, 128), Scheme(1 / 255)


def lost(body: str, channels: int, output: str = "", **schemes: Scheme) -> set[str]:
    """Which convolutions of the graph lose in 8 bits, for images of so many channels; `output` is one too."""
    c, rng = channels, np.random.default_rng(0)
    shapes = {"w": (c, c, 1, 1), "v": (c, c, 1, 1), "v2": (c, 2 * c, 1, 1), "fewer": (8, c, 1, 1), "more": (c, 8, 7, 7),
              "large": (c, c, 3, 3), "third": (c // 3, c, 1, 1)}  # fmt: skip
    used = {name: rng.standard_normal(shape).astype(np.float32) for name, shape in shapes.items() if name in body}
    model = small.written(body, used, [1, channels, 4, 4])
    if output:
        model.graph.output.append(helper.make_tensor_value_info(output, TensorProto.FLOAT, None))
    lowered, origins = rewrite(GraphView(model), dict.fromkeys(candidates(GraphView(model)), SIGNED) | schemes)
    assert lowered.graph.output == model.graph.output
    return losing(lowered, origins, rng.standard_normal((1, channels, 4, 4)).astype(np.float32))


POOL = "Pool<kernel_shape = [1, 1]>"


@pytest.mark.parametrize(
    ("between", "loses", "pays"),
    [
        # 2 C / 60 + what is gained in between = 8.
        ("m = Relu(c)", 240, 244),
        ("m = Transpose<perm = [0, 1, 3, 2]>(c)", 240, 244),
        (f"m = Max{POOL}(c)", 208, 212),
        (f"m = Average{POOL}(c)", 208, 212),
        ("m = Add(c, c)", 208, 212),
        # A mask is a convolution, and a product.
        ("r = Relu(c)  k = elf.Step(r)  m = Mul(r, k)", 180, 184),
        # 2 C / 60 = 8 + 6: something reads it in floats.
        ("m = Relu(c)  f = Cos(m)", 420, 424),
    ],
)
def test_a_region_has_to_save_twice_what_it_costs(between: str, loses: int, pays: int) -> None:
    """All of it is left, or nothing."""
    last = "e = Cos(d)  y = Sub(e, f)" if "f =" in between else "y = Cos(d)"
    body = f"s = Sin(x)  c = Conv(s, w)  {between}  d = Conv(m, v)  {last}"
    assert lost(body, loses, r=POSITIVE) == {"c", "d"}
    assert lost(body, pays, r=POSITIVE) == set()


def test_a_convolution_alone_has_to_save_twice_what_it_costs() -> None:
    """C / 60 = 8: where both are the same it is left."""
    body = "s = Sin(x)  c = Conv(s, w)  y = Cos(c)"
    assert lost(body, 480) == {"c"}
    assert lost(body, 484) == set()


@pytest.mark.parametrize("other", [SIGNED, Scheme(2 / 127, 128)])
def test_maps_that_are_joined_are_worth_a_map_of_both_their_sizes(other: Scheme) -> None:
    """C / 60 + 2 C / 60 + 1 + 2 = 8, whether integers are joined as they are or rounded again."""
    body = f"s = Sin(x)  c = Conv(s, w)  a = Average{POOL}(c)  m = Concat<axis = 1>(c, a)  d = Conv(m, v2)  y = Cos(d)"
    assert lost(body, 100, a=other) == {"c", "d"}
    assert lost(body, 104, a=other) == set()


def test_channels_that_are_copied_cost_eight_each() -> None:
    """Three channels in, out for their rests, which come in too; six joined, eight copied: 2 (3 + 9 + 3 + 6 + 32).
    With K results of 4 x 121: 106 + 6 K = 484 K / 60 is beyond 51 channels."""
    for results, pays in ((51, False), (52, True)):
        kernel = small.weights(results, 3, 11, 11)
        body = "s = Sin(x)  c = Conv<pads = [5, 5, 5, 5]>(s, w)  y = Cos(c)"
        model = small.written(body, {"w": kernel}, [1, 3, 8, 8])
        lowered, origins = rewrite(GraphView(model), {"s": SIGNED, "c": SIGNED})
        assert losing(lowered, origins, np.ones((1, 3, 8, 8), np.float32)) == (set() if pays else {"c"})


def test_a_convolution_in_floats_parts_two_regions() -> None:
    """C / 60 = 8 before it; behind it 392 C / 60 = 2 8 + 6 C, which is 30 channels, as 8 enter again."""
    between = "f = Conv(c, fewer)  m = Relu(f)"
    body = f"s = Sin(x)  c = Conv(s, w)  {between}  d = Conv<pads = [3, 3, 3, 3]>(m, more)  y = Cos(d)"
    assert lost(body, 30) == {"c", "d"}
    assert lost(body, 31) == {"c"}
    assert lost(body, 480) == {"c"}
    assert lost(body, 484) == set()


@pytest.mark.parametrize("between", ["m = Relu(c)", "m = Add(x, c)"])
def test_a_value_in_floats_parts_two_regions(between: str) -> None:
    """An output, or a sum with the image itself: what follows enters again, at C / 60 = 8."""
    output = "c" if "Relu" in between else ""
    body = f"s = Sin(x)  c = Conv(s, w)  {between}  d = Conv(m, v)  y = Cos(d)"
    assert lost(body, 480, output) == {"c", "d"}
    assert lost(body, 484, output) == ({"c"} if output else set())


SMALL, LARGE = "a = Conv(c, third)", "b = Conv<pads = [1, 1, 1, 1]>(c, large)"


@pytest.mark.parametrize("order", [f"{SMALL}  {LARGE}", f"{LARGE}  {SMALL}"])
def test_branches_hang_together(order: str) -> None:
    """One pays for the other: with it the region saves 31/3 C / 60 and costs 2 + 6/3 + 6."""
    body = f"s = Sin(x)  c = Conv(s, w)  {order}  e = Cos(a)  f = Cos(b)  y = Concat<axis = 1>(e, f)"
    assert lost(body, 48) == {"a", "b", "c"}
    assert lost(body, 60) == set()
