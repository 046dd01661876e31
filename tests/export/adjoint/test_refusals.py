"""Nodes of ops that have a rule, in a form that the rule does not take: reported, with the reason."""

from __future__ import annotations

import pytest

from elf_export.adjoint import build_adjoint
from elf_export.errors import UnsupportedGraphError
from elf_export.graph.graph import Graph

from .test_engine import model

pytestmark = pytest.mark.torch

IMAGE = "float[N,4,H,W] x"
REFUSED = [
    ("y = Conv(x, w)", f"{IMAGE}, float[O,4,k,k] w", "", 17, "kernel's shape must be static"),
    ("y = ConvTranspose<output_shape=[9,9]>(x, w)", f"{IMAGE}, float[4,2,3,3] w", "", 17, "output_shape"),
    (
        'y = ConvTranspose<auto_pad="SAME_UPPER", strides=[3,3]>(x, w)',
        f"{IMAGE}, float[4,2,2,2] w",
        "",
        17,
        "stride beyond the kernel",
    ),
    ("y = MaxPool<kernel_shape=[2,2], storage_order=1>(x)", IMAGE, "", 17, "storage_order=1"),
    (
        "y, m, v = BatchNormalization<training_mode=1>(x, s, s, s, s)",
        f"{IMAGE}, float[4] s",
        "",
        15,
        "training_mode=1; export the model for inference",
    ),
    ("y = Dropout(x, r, t)", f"{IMAGE}, float r, bool t", "", 17, "training_mode"),
    (
        "y = Slice(x, b, e, a)",
        f"{IMAGE}, int64[1] b, int64[1] e, int64[1] a",
        "",
        17,
        "axes that are computed",
    ),
    (
        "y = Slice(x, b, b, a, s)",
        f"{IMAGE}, int64[1] b, int64[1] s",
        "int64[1] a = {2}",
        17,
        "steps that are computed",
    ),
    ('y = Pad<mode="edge">(x, p)', f"{IMAGE}, int64[8] p", "", 17, "mode 'edge' with pads that are computed"),
    ("y = Pad(x, p)", IMAGE, "int64[8] p = {0, 0, -1, 0, 0, 0, 0, 0}", 17, "pads below zero"),
    ("y = ReduceMean(x, a)", f"{IMAGE}, int64[1] a", "", 18, "axes that are computed"),
    (
        'y = Resize<mode="linear", coordinate_transformation_mode="tf_crop_and_resize">(x, r, s)',
        f"{IMAGE}, float[8] r",
        "float[4] s = {1, 1, 2, 2}",
        17,
        "tf_crop_and_resize.*supported: half_pixel",
    ),
    ('y = Resize<mode="linear", antialias=1>(x, , s)', IMAGE, "float[4] s = {1, 1, 2, 2}", 18, "antialias=1"),
    (
        'y = Resize<mode="cubic", exclude_outside=1>(x, , s)',
        IMAGE,
        "float[4] s = {1, 1, 2, 2}",
        17,
        "exclude_outside=1",
    ),
    (
        'y = Resize<keep_aspect_ratio_policy="not_larger">(x, , , s)',
        IMAGE,
        "int64[4] s = {1, 4, 8, 8}",
        18,
        "keep_aspect_ratio_policy 'not_larger'",
    ),
    ("y = MatMul(x, v)", f"{IMAGE}, float[W] v", "", 17, "'v' must have a known rank of at least 2"),
    ("z = Unique<axis=0>(x) y = Relu(z)", "float[N] x", "", 17, "no rule"),
]


@pytest.mark.parametrize(("body", "inputs", "constants", "opset", "reason"), REFUSED, ids=[row[-1] for row in REFUSED])
def test_refused(body: str, inputs: str, constants: str, opset: int, reason: str) -> None:
    graph = Graph(model(body, inputs, opset, constants))
    before = len(graph.nodes)
    with pytest.raises(UnsupportedGraphError, match=reason) as caught:
        build_adjoint(graph, "y", "x")
    assert len(graph.nodes) == before
    assert all(node.opset == opset and node.name for node in caught.value.nodes)
