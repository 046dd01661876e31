"""A file takes every size that its contract promises, and a list shows what an export then does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest

from elf_export import ExportError, export_onnx
from elf_export.cli import main
from elf_runtime import ElfRuntime
from export import small_models as small
from helpers import textured

pytestmark = pytest.mark.usefixtures("one_direction")

ODD = ((66, 71), (71, 98), (98, 66), (67, 131), (130, 97))  # rows and columns

# model, layer, multiple and least of its sizes, stride of the layer
MODELS = {
    "U-Net, full size": (small.unet(3), "up0", 8, 32, 1),
    "U-Net, half": (small.unet(3), "up1", 8, 32, 2),
    "U-Net, a quarter": (small.unet(3), "up2", 8, 32, 4),
    "U-Net of two levels": (small.unet(2), "up1", 4, 32, 2),
    "U-Net of five levels, a sixteenth": (small.unet(5), "up4", 32, 32, 16),
    "U-Net of transposed convolutions": (small.unet(3, transposed=True), "up1", 8, 32, 2),
    "U-Net that states a size": (small.unet(3, size=(1, 3, 64, 64)), "up1", 8, 32, 2),
    "U-Net's encoder": (small.unet(3), "kept2", 1, 32, 4),
    "windows of 7": (small.windows(7), "y", 28, 56, 4),
    "windows of 8": (small.windows(8), "y", 32, 32, 4),
    "windows of 5": (small.windows(5), "y", 20, 40, 4),
    "windows of 12, patches of 2": (small.windows(12, 2), "y", 24, 48, 2),
    "windows of 7, 224 pixels": (small.windows(7, size=(1, 3, 224, 224)), "y", 28, 56, 4),
}  # fmt: skip


def saved(model: onnx.ModelProto, folder: Path) -> Path:
    onnx.save(model, folder / "model.onnx")
    return folder / "model.onnx"


@pytest.mark.parametrize("name", MODELS)
def test_every_size_that_is_promised_runs(tmp_path: Path, name: str) -> None:
    model, layer, multiple, least, stride = MODELS[name]
    contract = export_onnx(saved(model, tmp_path), layer, [layer], tmp_path / "elf.onnx").contract
    spec = contract.input
    assert (spec.multiple, spec.min_size, spec.height, spec.width) == (multiple, least, 0, 0)
    assert (contract.stride, contract.descriptors[0].stride) == (stride, stride)
    elf = ElfRuntime(tmp_path / "elf.onnx")
    for height, width in ODD:
        found = elf.detect(textured(height, width), border=2)
        assert len(found) > 0
        assert np.isfinite(found.descriptors).all()
    # And every multiple in two periods of the network, of which the exporter tries one.
    for i in range(64 // multiple + 1):
        assert elf.saliency(textured(least + i * multiple, least)).shape == (least + i * multiple, least)
        assert elf.saliency(textured(least, least + i * multiple)).shape == (least, least + i * multiple)


@pytest.mark.parametrize("name", MODELS)
def test_the_list_shows_what_the_export_then_does(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    model, layer, *_, stride = MODELS[name]
    path = saved(model, tmp_path)
    assert main(["--onnx", str(path), "--list"]) == 0
    listed = capsys.readouterr().out.splitlines()
    lines: list[str] = []
    export_onnx(path, layer, [], tmp_path / "elf.onnx", log=lines.append)
    if "encoder" not in name:  # which alone takes more sizes than the whole does
        assert listed[0].removeprefix("images: ") == lines[0].split("sizes: ")[1]
    rows = {line.split()[0]: line.split() for line in listed[3:]}
    row = rows["map" if layer == "y" else layer]  # y is a Transpose of it
    assert float(row[4]) == stride


def test_a_small_size_that_the_file_states_hides_no_stride(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A space-to-depth written as a Reshape, on an image of four cells: too few to tell a stride by."""
    shape = {"a": np.array([0, 3, 4, 8, 4, 8]), "b": np.array([0, 192, 4, 4])}
    body = """parts = Reshape(x, a)  moved = Transpose<perm=[0,1,3,5,2,4]>(parts)  cells = Reshape(moved, b)
              conv = Conv(cells, w)  y = Relu(conv)"""
    path = saved(small.written(body, {**shape, "w": small.weights(4, 192, 1, 1)}, (1, 3, 32, 32)), tmp_path)
    assert main(["--onnx", str(path), "--list"]) == 0
    row = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("y "))
    contract = export_onnx(path, "y", ["y"], tmp_path / "elf.onnx").contract
    assert float(row.split()[4]) == contract.stride == contract.descriptors[0].stride == 8


def test_a_table_of_positions_bounds_the_sizes(tmp_path: Path) -> None:
    """Cells beyond the 64 x 64 of a learned table have no position: refused free, exported at the size of the file."""
    body = """embedded = Conv(x, w)  sizes = Shape(embedded)  h = Slice(sizes, two, four)
              part = Slice(table, start, h, axes)  y = Add(embedded, part)"""
    tensors = {
        "w": small.weights(4, 3, 4, 4), "table": small.weights(1, 4, 64, 64, seed=1), "two": np.array([2]),
        "four": np.array([4]), "start": np.array([0, 0]), "axes": np.array([2, 3]),
    }  # fmt: skip

    def model(size: tuple[int | str, ...]) -> onnx.ModelProto:
        result = small.written(body, tensors, size)
        result.graph.node[0].attribute.append(onnx.helper.make_attribute("strides", [4, 4]))
        return result

    with pytest.raises(ExportError, match=r"at no size that was tried: .* \(at (32x2048|2048x32) pixels\)"):
        export_onnx(saved(model(("N", 3, "H", "W")), tmp_path), "y", [], tmp_path / "elf.onnx")
    spec = export_onnx(saved(model((1, 3, 96, 128)), tmp_path), "y", [], tmp_path / "elf.onnx").contract.input
    assert (spec.height, spec.width) == (96, 128)
