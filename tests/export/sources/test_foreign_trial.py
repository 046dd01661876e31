"""elf-export --onnx writes no file that the runtime then refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest

from elf_export import ExportError, export_onnx, pipeline
from elf_runtime import ElfRuntime
from export import small_models as small
from helpers import textured

pytestmark = pytest.mark.usefixtures("one_direction")


def deep_pyramid() -> onnx.ModelProto:
    """Five strides of 2, and back to a stride of 4 beside what was kept, by factors of 2."""
    tensors = {"scales": np.array([1, 1, 2, 2], np.float32)}
    body, x = "", "x"
    for i in range(5):
        tensors[f"w{i}"] = small.weights(8, 3 if i == 0 else 8, 3, 3, seed=i)
        body += f"c{i} = Conv<pads = [1, 1, 1, 1], strides = [2, 2]>({x}, w{i})  f{i} = Relu(c{i})  "
        x = f"f{i}"
    for i in (3, 2, 1):
        body += f'u{i} = Resize<mode = "nearest">({x}, , scales)  {"y" if i == 1 else f"s{i}"} = Add(f{i}, u{i})  '
        x = f"s{i}"
    return small.written(body, tensors, ("N", 3, "H", "W"))


def test_maps_of_a_pyramid_are_taken_at_every_size_that_is_stated(tmp_path: Path) -> None:
    onnx.save(deep_pyramid(), tmp_path / "model.onnx")
    made = export_onnx(tmp_path / "model.onnx", "y", ["y"], tmp_path / "elf.onnx")
    elf, spec = ElfRuntime(made.path), made.contract.input
    assert made.contract.descriptors[0].stride == 4.0
    for height in range(spec.min_size, spec.min_size + 5 * spec.multiple, spec.multiple):
        assert elf.detect(textured(height, spec.min_size)).descriptors.shape[1] == 8


def test_a_file_that_the_runtime_refuses_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stride that the map does not have, behind the back of what looks for sizes that it would do for."""
    model, states, found = small.nchw(("N", 3, "H", "W")), pipeline.descriptor_specs, pipeline.sizes_that_run

    def wrong(*given: object) -> tuple[object, ...]:
        return tuple(type(spec)(spec.output, spec.layer, spec.dim, 9.0, 4.0) for spec in states(*given))  # type: ignore[arg-type]

    onnx.save(model, tmp_path / "model.onnx")
    monkeypatch.setattr(pipeline, "descriptor_specs", wrong)
    monkeypatch.setattr(pipeline, "sizes_that_run", lambda *given: found(*given[:4], ()))
    with pytest.raises(ExportError, match=r"the runtime refuses the finished file on an image of 32x32 pixels: "):
        export_onnx(tmp_path / "model.onnx", "relu2", ["relu2"], tmp_path / "elf.onnx")
    assert not (tmp_path / "elf.onnx").exists()
