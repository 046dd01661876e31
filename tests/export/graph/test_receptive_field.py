"""Stride, offset and receptive field of small maps, against the columns of the image that move a cell."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import onnx
import onnxruntime as ort
import pytest
from onnx import TensorProto, helper

from elf_export.graph.receptive_field import Field, receptive_fields
from export import small_models as small

HEIGHT = 12
MARGIN = 3  # a dilated kernel that the edge cuts may see no column nearer to it


def node(op: str, *inputs: str, name: str = "y", **attributes: Any) -> onnx.NodeProto:
    return helper.make_node(op, list(inputs), [name], name=name, **attributes)


def built(*nodes: onnx.NodeProto, opset: int = 17, channels: int = 1, **tensors: np.ndarray) -> onnx.ModelProto:
    """From x to the last node's output."""
    return small.model(list(nodes), tensors, ("n", channels, "h", "w"), nodes[-1].output[0], opset)


def ones(*shape: int) -> np.ndarray:
    return np.ones(shape, np.float32)


def seen_columns(model: onnx.ModelProto, width: int, more: dict[str, np.ndarray] | None = None) -> np.ndarray:
    """(cells, width) bool: which columns of the image move a cell of the map's middle row; weights are positive."""
    session = ort.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    channels = session.get_inputs()[0].shape[1]
    columns = np.eye(width, dtype=np.float32)[:, None, None, :].repeat(channels, 1).repeat(HEIGHT, 2)
    (maps,) = session.run(None, {"x": columns, **(more or {})})
    return np.asarray((maps[:, :, maps.shape[2] // 2] > 0).any(1).T)


def assert_field_is_what_cells_see(field: Field, seen: np.ndarray, period: int = 1) -> None:
    """Of the cells that no edge cuts, in whole periods: their middles on average, and the widest of them."""
    first, last = seen.argmax(1), seen.shape[1] - 1 - seen[:, ::-1].argmax(1)
    inner = np.flatnonzero((first >= MARGIN) & (last < seen.shape[1] - MARGIN))
    inner = inner[: len(inner) // period * period]
    assert len(inner) >= 2 * period
    middles = (first + last)[inner] / 2
    assert np.mean(middles - (field.offset + inner * field.stride)) == pytest.approx(0)
    assert np.abs(middles - (field.offset + inner * field.stride)).max() <= 0.5
    assert (last - first)[inner].max() + 1 == field.size


@dataclass(frozen=True)
class Case:
    model: onnx.ModelProto
    period: int = 1  # cells after which the pattern of what they see repeats
    width: int = 24


UP = np.array([1, 1, 1, 2], np.float32)
TO_SIZES = np.array([24, 1, HEIGHT, 48], np.int64)
CASES = {
    "uneven pads": Case(built(node("Conv", "x", "w", kernel_shape=[1, 5], strides=[1, 2], pads=[0, 3, 0, 0]),
                              w=ones(1, 1, 1, 5))),
    "dilation": Case(built(node("Conv", "x", "w", dilations=[1, 3], pads=[1, 3, 1, 3]), w=ones(1, 1, 3, 3))),
    "another kernel down": Case(built(node("Conv", "x", "w", strides=[3, 1], pads=[2, 0, 2, 0]), w=ones(1, 1, 5, 3))),
    "max pool": Case(built(node("MaxPool", "x", kernel_shape=[2, 3], strides=[1, 3]))),
    "average pool": Case(built(node("AveragePool", "x", kernel_shape=[2, 4], strides=[2, 2], pads=[0, 1, 0, 1]))),
    "Lp pool": Case(built(node("LpPool", "x", kernel_shape=[2, 3], strides=[1, 2], p=2))),
    "a stride before a kernel": Case(built(
        node("Conv", "x", "w", name="a", strides=[1, 2], pads=[1, 1, 1, 1]),
        node("Conv", "a", "w", name="b", strides=[1, 2], pads=[1, 0, 1, 2]), w=ones(1, 1, 3, 3))),
    "SAME_UPPER, even": Case(built(node("Conv", "x", "w", strides=[1, 2], auto_pad="SAME_UPPER"), w=ones(1, 1, 3, 3))),
    "SAME_UPPER, odd": Case(built(node("Conv", "x", "w", strides=[1, 2], auto_pad="SAME_UPPER"), w=ones(1, 1, 3, 3)),
                            width=25),
    "SAME_LOWER, even": Case(built(node("Conv", "x", "w", strides=[1, 2], auto_pad="SAME_LOWER"), w=ones(1, 1, 3, 3))),
    "transposed, even kernel": Case(built(
        node("ConvTranspose", "x", "w", strides=[1, 2], pads=[0, 1, 0, 1]), w=ones(1, 1, 1, 4)), 2),
    "transposed, odd kernel": Case(built(
        node("ConvTranspose", "x", "w", kernel_shape=[1, 3], strides=[1, 2], pads=[0, 1, 0, 0]),
        w=ones(1, 1, 1, 3)), 2),
    "transposed, behind a stride": Case(built(
        node("MaxPool", "x", name="a", kernel_shape=[1, 2], strides=[1, 2]),
        node("ConvTranspose", "a", "w", strides=[1, 2]), w=ones(1, 1, 1, 5)), 2, 48),
    "transposed, SAME_UPPER": Case(built(
        node("ConvTranspose", "x", "w", strides=[1, 2], auto_pad="SAME_UPPER"), w=ones(1, 1, 1, 5)), 2),
    "transposed, SAME_UPPER, odd": Case(built(
        node("ConvTranspose", "x", "w", strides=[1, 2], auto_pad="SAME_UPPER"), w=ones(1, 1, 1, 3)), 2, 25),
    "transposed, SAME_LOWER, odd": Case(built(
        node("ConvTranspose", "x", "w", strides=[1, 2], auto_pad="SAME_LOWER"), w=ones(1, 1, 1, 4)), 2, 25),
    "transposed, SAME_LOWER, even": Case(built(
        node("ConvTranspose", "x", "w", strides=[1, 2], auto_pad="SAME_LOWER"), w=ones(1, 1, 1, 5)), 2),
    "transposed, SAME_UPPER, one pixel more": Case(built(
        node("ConvTranspose", "x", "w", strides=[1, 2], auto_pad="SAME_UPPER", output_padding=[0, 1]),
        w=ones(1, 1, 1, 3)), 2),
    "transposed, no pads": Case(built(
        node("ConvTranspose", "x", "w", strides=[3, 2]), w=ones(1, 1, 5, 2)), 2),
    "nearest": Case(built(node("Resize", "x", "", "s", mode="nearest"), s=UP), 2),
    "nearest by default": Case(built(node("Resize", "x", "", "s"), s=UP), 2),
    "nearest, asymmetric": Case(built(
        node("Resize", "x", "", "s", mode="nearest", coordinate_transformation_mode="asymmetric",
             nearest_mode="floor"), s=UP), 2),
    "linear": Case(built(node("Resize", "x", "", "s", mode="linear"), s=UP), 2),
    "linear, asymmetric": Case(built(
        node("Resize", "x", "", "s", mode="linear", coordinate_transformation_mode="asymmetric"), s=UP), 2),
    "linear, behind a stride": Case(built(
        node("MaxPool", "x", name="a", kernel_shape=[1, 2], strides=[1, 2]),
        node("Resize", "a", "", "s", mode="linear"), s=UP), 2, 48),
    "to sizes": Case(built(node("Resize", "x", "", "", "s", mode="nearest"), s=TO_SIZES), 2),
    "Upsample": Case(built(node("Upsample", "x", "s", mode="nearest"), s=UP, opset=9), 2),
    "SpaceToDepth": Case(built(node("SpaceToDepth", "x", blocksize=3))),
    "DepthToSpace": Case(built(node("DepthToSpace", "x", blocksize=2), channels=4), 2),
    "the wider branch, second": Case(built(
        node("Relu", "x", name="a"), node("Conv", "x", "w", name="b", pads=[0, 0, 0, 4]), node("Add", "a", "b"),
        w=ones(1, 1, 1, 5))),
    "the wider branch, first": Case(built(
        node("Relu", "x", name="a"), node("Conv", "x", "w", name="b", pads=[0, 0, 0, 4]), node("Add", "b", "a"),
        w=ones(1, 1, 1, 5))),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_a_cell_lies_in_the_middle_of_what_it_sees(name: str) -> None:
    case = CASES[name]
    image = case.model.graph.input[0].name
    field = receptive_fields(case.model, image, (HEIGHT, case.width))[case.model.graph.output[0].name]
    assert_field_is_what_cells_see(field, seen_columns(case.model, case.width), case.period)


@pytest.mark.parametrize(("op", "opset", "inputs"), [("Upsample", 9, ["x", "s"]), ("Resize", 17, ["x", "", "s"])])
def test_the_factor_is_the_scale_that_is_stated_where_the_size_is_rounded(
    op: str, opset: int, inputs: list[str]
) -> None:
    """25 columns become 37, one and a half times as many but for a half."""
    model = built(node(op, *inputs, mode="nearest"), opset=opset, s=np.array([1, 1, 1, 1.5], np.float32))
    assert receptive_fields(model, "x", (HEIGHT, 25))["y"].stride == pytest.approx(1 / 1.5, rel=1e-12)


def test_a_cell_behind_a_gate_sees_the_image_and_lies_where_the_gated_map_does() -> None:
    """Squeeze and excitation, the gate first or last, of the map itself or of another."""
    for order in (("a", "gate"), ("gate", "a")):
        for pool, squeezed in (("GlobalAveragePool", "a"), ("GlobalMaxPool", "x")):
            model = built(
                node("MaxPool", "x", name="a", kernel_shape=[1, 4], strides=[1, 4]),
                node(pool, squeezed, name="squeezed"), node("Sigmoid", "squeezed", name="gate"), node("Mul", *order),
            )  # fmt: skip
            assert receptive_fields(model, "x")["y"] == Field(4.0, 1.5, math.inf)


@pytest.mark.parametrize("op", ["MatMul", "Gemm"])
def test_a_linear_layer_sees_the_image(op: str) -> None:
    model = built(node("Flatten", "x", name="flat"), node(op, "flat", "w"), w=ones(HEIGHT * 24, 2))
    assert receptive_fields(model, "x", (HEIGHT, 24))["y"].size == math.inf


def test_every_output_of_a_node_has_a_field() -> None:
    nodes = [
        node("MaxPool", "x", name="a", kernel_shape=[1, 2], strides=[1, 2]),
        helper.make_node("Split", ["a"], ["left", "right"], name="split", axis=3),
        node("Relu", "right"),
    ]
    fields = receptive_fields(small.model(nodes, {}, ("n", 1, "h", "w"), "y", 13), "x")
    assert fields["left"] == fields["right"] == fields["y"] == Field(2.0, 0.5, 2.0)


def test_a_value_that_no_pixel_reaches_has_none() -> None:
    model = built(node("Relu", "w", name="a"), node("Add", "x", "a"), w=ones(1))
    assert set(receptive_fields(model, "x")) == {"x", "y"}


# A kernel of 3 and a stride of 2 under SAME_UPPER: the one pixel of padding is behind, the two of an odd width around.
OFFSETS = {24: 1.0, 25: 0.0}


@pytest.mark.parametrize("width", OFFSETS)
def test_the_offset_is_stated_for_the_size_that_is_asked_for(width: int) -> None:
    same = {"auto_pad": "SAME_UPPER", "strides": [2, 2]}
    kernel = {"w": ones(1, 3, 3, 3)}
    nchw = small.model([node("Conv", "x", "w", **same)], kernel, ("n", 3, "h", "w"), "y")
    turned = [node("Transpose", "x", name="t", perm=[0, 3, 1, 2]), node("Conv", "t", "w", **same)]
    nhwc = small.model(turned, kernel, ("n", "h", "w", 3), "y")
    for height in OFFSETS:
        for model in (nchw, nhwc):
            assert receptive_fields(model, "x", (height, width))["y"].offset == OFFSETS[width]
    fixed = small.model([node("Conv", "x", "w", **same)], kernel, (1, 3, 12, width), "y")
    for asked in OFFSETS:
        assert receptive_fields(fixed, "x", (asked, asked))["y"].offset == OFFSETS[width]


def test_the_size_is_the_paper_s_by_default() -> None:
    model = built(node("Conv", "x", "w", auto_pad="SAME_UPPER", strides=[1, 7]), w=ones(1, 1, 1, 9))
    at = {size: receptive_fields(model, "x", size)["y"].offset for size in ((480, 640), (640, 480))}
    assert receptive_fields(model, "x")["y"].offset == at[480, 640] != at[640, 480]


@pytest.mark.parametrize("auto_pad", ["SAME_UPPER", "SAME_LOWER"])
def test_where_a_map_s_size_is_not_known_the_stride_is_taken_to_divide_it(auto_pad: str) -> None:
    """The image, cut to a width that is fed."""
    model = built(
        node("Slice", "x", "zero", "wide", "axis", name="cut"),
        node("Conv", "cut", "w", auto_pad=auto_pad, strides=[1, 2]),
        zero=np.zeros(1, np.int64), axis=np.array([3]), w=ones(1, 1, 1, 5),
    )  # fmt: skip
    model.graph.input.append(helper.make_tensor_value_info("wide", TensorProto.INT64, [1]))
    field = receptive_fields(model, "x", (HEIGHT, 24))["y"]
    assert_field_is_what_cells_see(field, seen_columns(model, 24, {"wide": np.array([22])})[:, :22])


def test_sizes_that_the_model_states_of_its_maps_do_not_stand_in_the_way() -> None:
    """Those of a narrower image, of a map inside and of one that is an output and is read too."""
    same = {"auto_pad": "SAME_UPPER", "strides": [1, 2]}
    model = built(
        node("Relu", "x", name="a"), node("Conv", "a", "w", name="b", **same), node("Conv", "b", "w", **same),
        w=ones(1, 1, 1, 3),
    )  # fmt: skip
    model.graph.value_info.append(helper.make_tensor_value_info("a", TensorProto.FLOAT, ["n", 1, HEIGHT, 24]))
    model.graph.output.append(helper.make_tensor_value_info("b", TensorProto.FLOAT, ["n", 1, HEIGHT, 12]))
    fields = receptive_fields(model, "x", (HEIGHT, 25))
    assert (fields["b"].offset, fields["y"].offset) == (0.0, 0.0)
