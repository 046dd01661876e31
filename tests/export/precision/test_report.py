"""What is said of a lowered model: keypoints and scores beside those of float32."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
from onnx import TensorProto

from elf_export import ExportError, export_network, export_onnx
from elf_export.calibration import calibration_set
from elf_export.checks import lower_precision, views
from elf_export.precision.half import bfloat16_weights
from elf_runtime import InputSpec
from export import small_models as small
from helpers import textured


def test_the_share_is_of_the_points_that_are_looked_for() -> None:
    points = np.array([[0.0, 0.0], [50.0, 50.0], [9.0, 9.0], [20.0, 21.0]], np.float32)
    others = np.array([[0.6, 0.8], [20.0, 20.0]], np.float32)
    assert lower_precision._near(points, others) == 0.5
    assert lower_precision._near(others, points) == 1.0
    assert (lower_precision._near(points[:0], others), lower_precision._near(points, others[:0])) == (1.0, 0.0)


def test_the_report() -> None:
    found = lower_precision.PrecisionCheck("int8", 0.97, 0.88, 490.0, 500.0, 71.0, 71.5, 47.9, 48.0, 0.35)
    lines = found.table().splitlines()
    assert lines[1].split() == ["fp32", "1", "100%", "500", "71.5", "48.0", "1"]
    assert lines[2].split() == ["int8", "0.9700", "88.0%", "490", "71.0", "47.9", "0.35"]
    assert len(lines) == 3
    assert found.figures()["lower_correlation"] == 0.97
    assert "lower_time" not in found.figures()  # another machine would write another file

    slow = lower_precision.PrecisionCheck("int8", 0.97, 0.88, 490.0, 500.0, 71.0, 71.5, None, None, 1.2)
    assert slow.table().splitlines()[-1].startswith("int8 is no faster here")
    assert "no faster" not in replace(slow, precision="bf16").table()
    assert replace(slow, precision="bf16").table().splitlines()[2].split()[-2:] == ["-", "1.20"]


def test_a_model_agrees_with_itself(tmp_path: Path, pictures: Path) -> None:
    onnx.save(small.nchw(("n", 3, "h", "w")), tmp_path / "model.onnx")
    path = export_onnx(tmp_path / "model.onnx", "relu2", ["relu2"], tmp_path / "elf.onnx").path
    found = lower_precision.measure(path.read_bytes(), path.read_bytes(), calibration_set(pictures))
    assert found.correlation == pytest.approx(1)
    assert (found.agreeing, found.keypoints, found.rep, found.ms) == (
        1.0, found.keypoints_fp32, found.rep_fp32, found.ms_fp32
    )  # fmt: skip
    assert found.rep > 30


@pytest.fixture(scope="module")
def small_elf(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    folder = tmp_path_factory.mktemp("small")
    onnx.save(small.nchw(("n", 3, "h", "w")), folder / "model.onnx")
    return export_onnx(folder / "model.onnx", "relu2", ["relu2"], folder / "elf.onnx").path.read_bytes()


def test_panoramas_and_images_below_the_smallest_size_are_compared(tmp_path: Path, small_elf: bytes) -> None:
    cv2.imwrite(str(tmp_path / "panorama.png"), textured(40, 5000))
    cv2.imwrite(str(tmp_path / "small.png"), textured(31, 40))
    images, spec = calibration_set(tmp_path), InputSpec(min_size=32)
    assert [image.shape[:2] for image in views.sources(images, spec, 1.0)] == [(32, 640), (32, 41)]
    assert lower_precision.measure(small_elf, small_elf, images).correlation == pytest.approx(1)


def test_bit_depths_are_compared_as_the_runtime_reads_them(tmp_path: Path, small_elf: bytes) -> None:
    """8 bits, 12 of 16 bits, and float: the same picture, the same figures but for the rounding of its view."""
    image = textured(300, 400)
    image[0, 0] = 255
    figures = []
    depths = {"8.png": image, "12.png": image.astype(np.uint16) * 16, "float.tif": np.float32(image) / 255}
    for name, pixels in depths.items():
        folder = tmp_path / name
        folder.mkdir()
        cv2.imwrite(str(folder / name), pixels)
        figures.append(lower_precision.measure(small_elf, small_elf, calibration_set(folder)))
    eight, *others = figures
    assert eight.keypoints > 50
    for found in others:
        assert found.keypoints == pytest.approx(eight.keypoints, rel=0.05)
        assert found.rep == pytest.approx(eight.rep, abs=5)


def test_an_enlarged_float_image_stays_within_its_range(tmp_path: Path, small_elf: bytes) -> None:
    pixels = np.zeros((16, 20), np.float32)
    pixels[4:9, 5:12] = 1
    cv2.imwrite(str(tmp_path / "f.tif"), pixels)
    assert lower_precision.measure(small_elf, small_elf, calibration_set(tmp_path)).correlation == pytest.approx(1)


def test_a_flat_image_does_not_count(tmp_path: Path, small_elf: bytes) -> None:
    def measured() -> lower_precision.PrecisionCheck:
        return replace(lower_precision.measure(small_elf, small_elf, calibration_set(tmp_path)), time=0)

    cv2.imwrite(str(tmp_path / "a.png"), textured(120, 160))
    alone = measured()
    cv2.imwrite(str(tmp_path / "b.png"), np.zeros((120, 160, 3), np.uint8))
    assert measured() == alone


def test_what_has_no_saliency_compares_nothing(tmp_path: Path, small_elf: bytes) -> None:
    """A panorama whose central part, which is taken, is flat."""
    image = textured(32, 3000)
    image[:, 1000:2000] = 7
    cv2.imwrite(str(tmp_path / "a.png"), image)
    with pytest.raises(ExportError, match=f"1 images of {tmp_path.name}: float32 finds no saliency in any"):
        lower_precision.measure(small_elf, small_elf, calibration_set(tmp_path))


def test_a_lost_saliency_is_refused(tmp_path: Path, pictures: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from elf_export.precision import lower as precision

    def drowned(model: onnx.ModelProto) -> onnx.ModelProto:
        lowered = bfloat16_weights(model)
        for tensor in lowered.graph.initializer:
            if tensor.data_type == TensorProto.BFLOAT16:
                noise = np.random.default_rng(0).standard_normal(tuple(tensor.dims)).astype(np.float32)
                halves = (noise.view(np.uint32) >> 16).astype(np.uint16)
                tensor.raw_data = halves.tobytes()
        return lowered

    monkeypatch.setattr(precision, "bfloat16_weights", drowned)
    monkeypatch.setattr(lower_precision, "LEAST_CORRELATION", 0.98)
    with pytest.raises(ExportError, match=r"bf16 loses the saliency of this network.*No file was written"):
        export_network("vgg", "pool2", [], tmp_path / "a.onnx", offline=True, precision="bf16", calibration=pictures)
    assert not list(tmp_path.iterdir())
