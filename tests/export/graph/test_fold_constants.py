"""The pass that folds integers computed from constants."""

from __future__ import annotations

import pytest

onnx = pytest.importorskip("onnx")

from onnx import parser  # noqa: E402

from elf_export.graph.graph import Graph  # noqa: E402
from elf_export.graph.passes import fold_constants  # noqa: E402

pytestmark = pytest.mark.torch


def folded(body: str) -> Graph:
    text = f'<ir_version: 8, opset_import: ["": 17]> g (float[N,3,H,W] x) => (float[a,b,c,d] y) {{ {body} }}'
    return fold_constants(Graph(parser.parse_model(text)))


def test_a_chain_of_integers_becomes_one_initializer() -> None:
    graph = folded(
        """a = Constant<value_ints=[4]>()  z = ConstantOfShape<value=int64[1]{0}>(a)
           b = Constant<value_ints=[0,0,1,2]>()  p = Concat<axis=0>(z, b)  y = Pad(x, p)"""
    )
    assert [n.op_type for n in graph.nodes] == ["Pad"]
    assert graph.constant("p").tolist() == [0, 0, 0, 0, 0, 0, 1, 2]


def test_what_depends_on_the_image_stays() -> None:
    graph = folded("s = Shape(x)  y = Expand(x, s)")
    assert [n.op_type for n in graph.nodes] == ["Shape", "Expand"]


def test_floats_and_random_numbers_stay() -> None:
    graph = folded(
        """c = Constant<value_floats=[0.5, 0.1]>()  s = Sqrt(c)  r = Bernoulli<dtype=7>(c)  f = Cast<to=1>(r)
           m = Add(f, s)  i = Constant<value_int=0>()  k = Gather(m, i)  y = Mul(x, k)"""
    )
    assert {"Sqrt", "Bernoulli", "Add"} <= {n.op_type for n in graph.nodes}
