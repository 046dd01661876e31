"""Where nodes do not explain a map's size, its stride is measured."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import onnx
import pytest

from elf_export import export_onnx
from elf_export.command.listing import layer_table
from elf_export.graph.receptive_field import Field, measured, receptive_fields
from elf_runtime import ElfRuntime
from export import small_models as small
from helpers import textured


@pytest.mark.parametrize(
    ("field", "cells", "stride"),
    [
        (Field(2, 0.5, 40), (48, 64), 2),
        (Field(2, 0.5, 40), (49, 63), 2),
        # Two convolutions without padding lose four rows and columns.
        (Field(2, 4.5, 10), (44, 60), 2),
        # What the walk takes for pointwise.
        (Field(1, 0, 3), (48, 64), 2),
        (Field(1, 0, math.inf), (48, 64), 2),
        (Field(4, 1.5, 99), (48, 64), 2),
        (Field(2, 0.5, 40), (12, 64), 2),
    ],
)
def test_a_field_is_held_against_the_map_s_size(field: Field, cells: tuple[int, int], stride: float) -> None:
    found = measured(field, (96, 128), cells)
    assert found.stride == stride
    explained = field.stride == stride and cells[0] > 12
    assert found == field if explained else math.isnan(found.size)
    assert explained or found.offset == (stride - 1) / 2


def unshuffled() -> onnx.ModelProto:
    """Two pixels a side to channels, by a Reshape as torch writes it, then a convolution of stride 2."""
    body = """
        size = Shape(x)  count = Slice(size, zero, one, zero)  rows = Slice(size, two, three, zero)
        columns = Slice(size, three, four, zero)  h = Div(rows, two)  w = Div(columns, two)
        six = Concat<axis = 0>(count, three, h, two, w, two)  r = Reshape(x, six)
        t = Transpose<perm = [0, 1, 3, 5, 2, 4]>(r)  four_axes = Concat<axis = 0>(count, twelve, h, w)
        u = Reshape(t, four_axes)  c = Conv<pads = [1, 1, 1, 1]>(u, k)  m = Relu(c)
        y = Conv<pads = [1, 1, 1, 1], strides = [2, 2]>(m, v)
    """
    ints = {"zero": 0, "one": 1, "two": 2, "three": 3, "four": 4, "twelve": 12}
    tensors = {name: np.array([value]) for name, value in ints.items()}
    kernels = {"k": small.weights(8, 12, 3, 3), "v": small.weights(8, 8, 3, 3)}
    return small.written(body, tensors | kernels, ("N", 3, "H", "W"))


def test_a_layer_behind_a_reshape_has_the_stride_of_its_map(tmp_path: Path) -> None:
    onnx.save(unshuffled(), tmp_path / "model.onnx")
    for layer, stride in (("m", 2.0), ("y", 4.0)):
        contract = export_onnx(tmp_path / "model.onnx", layer, ["y"], tmp_path / "elf.onnx", force=True).contract
        assert contract.stride == stride
        assert (contract.descriptors[0].stride, contract.descriptors[0].offset) == (4.0, 1.5)


def test_the_list_shows_the_stride_of_a_map_and_no_receptive_field_that_contradicts_it() -> None:
    rows = {line.split()[0]: line.split()[1:6] for line in layer_table(unshuffled(), "x").splitlines()}
    assert rows["m"] == ["Relu", "8", "256x256", "2", "?"]
    assert rows["y"] == ["Conv", "8", "128x128", "4", "?"]


@pytest.mark.parametrize(
    ("field", "cells", "larger", "stride"),
    [
        # Padded to windows of 7 cells, and to 12: what is added to the image brings cells of the walk's stride.
        (Field(4, 1.5, math.inf), (28, 35), (49, 70), 4),
        (Field(4, 1.5, math.inf), (24, 36), (48, 72), 4),
        # What the walk takes for pointwise, and a Resize to computed sizes that it takes for none.
        (Field(1, 0, 3), (52, 68), (100, 132), 2),
        (Field(16, 0, 40), (25, 33), (49, 65), 4),
    ],
)
def test_two_sizes_of_a_map_tell_its_stride(
    field: Field, cells: tuple[int, int], larger: tuple[int, int], stride: float
) -> None:
    found = measured(field, (96, 128), cells, ((192, 256), larger))
    assert found.stride == stride
    assert found.offset == (1.5 if stride == field.stride else (stride - 1) / 2)
    assert math.isnan(found.size)


def test_a_table_of_positions_is_no_map() -> None:
    """Patches of 4 and a table of 6x6 positions, enlarged to the patches' number: it sees no pixel."""
    body = """patches = Conv<strides = [4, 4]>(x, w)  sizes = Shape(patches)
        ends = Slice(sizes, two, four)  wanted = Concat<axis = 0>(leading, ends)
        places = Resize<mode = "linear">(table, , , wanted)  y = Add(patches, places)"""
    tensors = {
        "w": small.weights(8, 3, 4, 4), "table": small.weights(1, 8, 6, 6, seed=1), "leading": np.array([1, 8]),
        "two": np.array([2]), "four": np.array([4]),
    }  # fmt: skip
    model = small.written(body, tensors, ("N", 3, "H", "W"))
    fields = receptive_fields(model, "x")
    assert fields["y"] == fields["patches"] == Field(4, 1.5, 4)
    assert not {"sizes", "wanted", "places"} & fields.keys()


@pytest.mark.parametrize("cells", [4, 7])
def test_a_map_padded_to_windows_has_its_stride_and_sizes_that_the_runtime_takes(tmp_path: Path, cells: int) -> None:
    body = """embedded = Conv<strides = [4, 4]>(x, w)  sizes = Shape(embedded)
        ends = Slice(sizes, two, four)  beyond = Neg(ends)  lack = Mod(beyond, side)
        pads = Concat<axis = 0>(zeros, lack)  y = Pad(embedded, pads)"""
    tensors = {
        "w": small.weights(8, 3, 4, 4), "zeros": np.zeros(6, np.int64), "side": np.array([cells]),
        "two": np.array([2]), "four": np.array([4]),
    }  # fmt: skip
    onnx.save(small.written(body, tensors, ("N", 3, "H", "W")), tmp_path / "model.onnx")
    contract = export_onnx(tmp_path / "model.onnx", "embedded", ["y"], tmp_path / "elf.onnx").contract
    assert (contract.descriptors[0].stride, contract.descriptors[0].offset) == (4.0, 1.5)
    elf, spec = ElfRuntime(tmp_path / "elf.onnx"), contract.input
    for height in range(spec.min_size, spec.min_size + 12 * 4 * cells, spec.multiple):
        elf.detect(textured(height, spec.min_size))
