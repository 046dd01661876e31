"""`ElfRuntime` on a file that gives keypoints itself: those of the model it was made of, and what can't be changed."""

from __future__ import annotations

import pickle
import runpy
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from elf_runtime import ContractError, ElfFeature2D, ElfRuntime, Features, ImageError, ModelContract, SettingError
from elf_runtime.contract import EndToEndSpec
from elf_runtime.contract.tensors import disagreement_alone
from helpers import TINY, TINY_ALONE, textured


@pytest.fixture(scope="module")
def alone() -> ElfRuntime:
    return ElfRuntime(TINY_ALONE, threads=1)


def assert_same(found: Features, wanted: Features) -> None:
    assert found.image_size == wanted.image_size
    np.testing.assert_allclose(found.keypoints, wanted.keypoints, atol=0.01)
    np.testing.assert_allclose(found.scores, wanted.scores, rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(found.descriptors, wanted.descriptors, atol=1e-3)
    np.testing.assert_array_equal(found.sizes, wanted.sizes)


def corner_mask(height: int, width: int) -> np.ndarray:
    mask = np.zeros((height, width), np.uint8)
    mask[height // 4 :, : 2 * width // 3] = 1
    return mask


def test_it_finds_what_the_model_finds(alone: ElfRuntime, elf: ElfRuntime) -> None:
    transparent = np.dstack([textured(90, 120), 255 * corner_mask(90, 120)])
    found = 0
    for image in (textured(120, 160), textured(90, 120, channels=1)[:, :, 0], transparent, textured(33, 40, 3)):
        for settings in ({}, {"max_keypoints": 7}, {"threshold": 0.3}, {"threshold": "none", "max_keypoints": 9000}):
            given: dict[str, Any] = {**settings, "mask": corner_mask(*image.shape[:2])}
            wanted = elf.detect(image, **settings)
            found += len(wanted)
            assert_same(alone.detect(image, **settings), wanted)
            assert_same(alone.detect(image, **given), elf.detect(image, **given))
    assert found > 100
    assert len(alone.detect(np.zeros((50, 60), np.uint8))) == 0
    assert len(alone.detect(textured(60, 60), max_keypoints=0)) == 0
    assert_same(alone.detect(textured(60, 60), max_keypoints=2**70), elf.detect(textured(60, 60), max_keypoints=2**70))


def test_files_warmup_records_copies_and_saliency(alone: ElfRuntime, elf: ElfRuntime, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), textured(64, 96))
    alone.warmup((64, 96))
    found, wanted = alone.detect(tmp_path / "a.png"), elf.detect(tmp_path / "a.png")
    assert_same(found, wanted)
    assert found.record is not None
    assert wanted.record is not None
    assert found.record == wanted.record | {"model": str(TINY_ALONE), "model_sha256": alone.sha256}
    assert_same(pickle.loads(pickle.dumps(alone)).detect(tmp_path / "a.png"), wanted)
    np.testing.assert_allclose(alone.saliency(textured(64, 96)), elf.saliency(textured(64, 96)), atol=1e-3)
    assert not alone.saliency(np.zeros((64, 96), np.uint8)).any()


def test_other_orders_of_channels(elf: ElfRuntime) -> None:
    image = textured(80, 100)
    assert_same(ElfRuntime(TINY_ALONE, color="rgb").detect(image[:, :, ::-1]), elf.detect(image))


def test_a_batch_one_after_another(alone: ElfRuntime, elf: ElfRuntime) -> None:
    images = [textured(60, 80, 0), np.zeros((60, 80, 3), np.uint8), textured(60, 80, 1), textured(70, 50, 2)]
    masks = [None, None, corner_mask(60, 80), None]
    for found, wanted in zip(
        alone.detect_batch(images, masks=masks), elf.detect_batch(images, masks=masks), strict=True
    ):
        assert_same(found, wanted)


def test_what_is_frozen_is_said(alone: ElfRuntime) -> None:
    image, detection = textured(60, 80), alone.contract.detection
    for settings, names in (
        ({"nms_radius": 4}, "nms_radius can't be changed; max_keypoints, threshold and a mask can be given"),
        ({"scale": 0.5, "border": 1}, "border, scale can't be changed"),
        ({"preset": "paper-webcam"}, "can't be changed"),
        ({"params": detection.updated(oriented=True)}, "oriented can't be changed"),
    ):
        with pytest.raises(SettingError, match=f"tiny-alone.onnx gives keypoints itself.*{names}"):
            alone.detect(image, **settings)
    assert_same(alone.detect(image, nms_radius=detection.nms_radius, preset="default"), alone.detect(image))
    with pytest.raises(SettingError, match="it can't describe others"):
        alone.describe(image, [[3, 4]])
    with pytest.raises(SettingError, match="no descriptor layer 'pool1'"):
        alone.detect(image, descriptor="pool1")
    trace = alone.trace(image)
    assert "keypoints" in repr(trace)
    assert trace.seconds["session"] > 0
    with pytest.raises(SettingError, match="gives no maps"):
        _ = trace.saliency
    for wrong, words in (
        (image.astype(np.uint16), "takes pixels of 8 bits, not uint16"),
        (np.zeros((20, 90), np.uint8), "the smallest is 32x32"),
    ):
        with pytest.raises(ImageError, match=words):
            alone.detect(wrong)


def test_as_one_of_opencv_s_detectors(alone: ElfRuntime, elf: ElfRuntime) -> None:
    points, rows = ElfFeature2D(alone, max_keypoints=5).detectAndCompute(textured(80, 100), None)
    assert len(points) == 5
    np.testing.assert_allclose(rows, elf.detect(textured(80, 100), max_keypoints=5).descriptors, atol=1e-3)


def test_a_contract_that_its_tensors_do_not_keep(alone: ElfRuntime) -> None:
    class Tensor:
        def __init__(self, name: str, kind: str, *shape: int | str) -> None:
            self.name, self.type, self.shape = name, f"tensor({kind})", shape

    image = Tensor("image", "uint8", 1, "H", "W", "C")
    outputs = [Tensor("keypoints", "float", "K", 2), Tensor("scores", "float", "K")]
    outputs.append(Tensor("descriptors", "float", "K", 8))
    described = alone.contract.descriptors

    def found(form: EndToEndSpec, inputs: list[Tensor], outputs: list[Tensor]) -> str:
        return disagreement_alone(form, "saliency", described, inputs, outputs) or ""

    assert found(EndToEndSpec(), [image], outputs) == ""
    for form, inputs, outs, words in (
        (EndToEndSpec(required=True), [image], outputs, "says inputs"),
        (EndToEndSpec("float32"), [image], outputs, "says float32"),
        (EndToEndSpec(), [image], outputs[:2], "says output 'descriptors'"),
        (EndToEndSpec(saliency=True), [image], outputs, "says output 'saliency'"),
        (EndToEndSpec(batch=True), [image], outputs, "of rank 3"),
    ):
        assert words in found(form, inputs, outs)
    metadata = alone.contract.to_metadata() | {"elf.end_to_end": '{"pixels": "int4"}'}
    with pytest.raises(ContractError, match=r"elf.end_to_end.*int4"):
        ModelContract.from_metadata(metadata, "x.onnx")


FORMS = [{"pixels": "float32", "color": "rgb", "required": True}, {"batch": True}, {"rounds": 12}]


@pytest.mark.torch
@pytest.mark.parametrize("form", FORMS, ids=["float32 rgb required", "batch", "rounds"])
def test_other_forms(form: dict[str, Any], elf: ElfRuntime) -> None:
    pytest.importorskip("onnx")
    made = runpy.run_path(str(TINY.with_name("make_tiny.py")))["alone"](**form)
    alone = ElfRuntime(made.SerializeToString(), threads=1)
    image = textured(80, 100)
    assert_same(alone.detect(image), elf.detect(image))
    if form.get("pixels") == "float32":
        deep = image.astype(np.uint16) * 257
        assert_same(alone.detect(deep), elf.detect(deep))
    images = [textured(60, 80, seed) for seed in range(3)]
    masks = [None, None, corner_mask(60, 80)]
    for found, wanted in zip(
        alone.detect_batch(images, masks=masks), elf.detect_batch(images, masks=masks), strict=True
    ):
        assert_same(found, wanted)
    with pytest.raises(SettingError, match="it has no saliency map"):
        alone.saliency(image)
    # A batch is padded to max_keypoints: the memory is not there for so many.
    assert_same(alone.detect(image, max_keypoints=10**12), elf.detect(image, max_keypoints=10**12))
