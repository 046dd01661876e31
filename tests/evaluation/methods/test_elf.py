"""ELF models as methods, on the small test model."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_eval.data.images import ImageRef
from elf_eval.errors import EvalError
from elf_eval.methods import open_method, open_methods
from elf_eval.protocol import Protocol
from elf_eval.run.extraction import Extraction, extract_features
from elf_runtime import ElfRuntime
from elf_runtime.model.bundled import bundled_model


def test_the_bundled_model_by_precision(tmp_path):
    prints = {p: open_method(f"elf?precision={p}", 1).fingerprint for p in ("fp32", "int8")}
    assert open_method("elf", 1).fingerprint == prints["int8"] != prints["fp32"]
    copy = shutil.copy(bundled_model("fp32"), tmp_path / "copy.onnx")
    assert open_method(f"elf:{copy}", 1).fingerprint == prints["fp32"]
    with pytest.raises(EvalError, match=r"precision=fp8.*fp32, int8"):
        open_method("elf?precision=fp8", 1)
    with pytest.raises(EvalError, match="unknown options"):
        open_method(f"elf:{copy}?precision=fp32", 1)


_ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def model():
    path = _ROOT / "tests" / "data" / "tiny.onnx"
    if not path.is_file():
        pytest.skip("no tests/data/tiny.onnx")
    return path


def test_an_elf_model_gives_what_its_runtime_gives(model, image):
    found = open_method(f"elf:{model}?preset=paper&nms_radius=5").extract(image, 40)
    direct = ElfRuntime(model).detect(image.pixels, preset="paper", nms_radius=5, max_keypoints=40)
    assert 0 < len(found) <= 40
    assert np.array_equal(found.keypoints, direct.keypoints)
    assert np.array_equal(found.descriptors, direct.descriptors)


def test_settings_reach_the_runtime_and_the_fingerprint(model, image):
    plain, wide = open_method(f"elf:{model}"), open_method(f"elf:{model}?nms_radius=25&scale=0.5")
    assert plain.fingerprint != wide.fingerprint
    assert plain.fingerprint == open_method(f"elf:{model}", threads=1).fingerprint
    assert len(wide.extract(image, 500)) < len(plain.extract(image, 500))
    few = open_method(f"elf:{model}?max_keypoints=7&grid=2,2&min_contrast=0&mask_border=auto")
    assert (len(few.extract(image, 500)), len(few.extract(image, 5))) == (7, 5)


def test_sift_keypoints_with_elf_descriptors(model, image):
    found = open_methods("sift", f"elf:{model}?descriptor=pool1").extract(image, 50)
    assert found.descriptors.shape == (len(found), 8)
    assert np.linalg.norm(found.descriptors, axis=1) == pytest.approx(1.0, abs=1e-5)
    expected = ElfRuntime(model).describe(image.pixels, found.keypoints, descriptor="pool1")
    assert np.array_equal(found.descriptors, expected)


def test_scales_with_their_sizes(model, image):
    method = open_method(f"elf:{model}?scales=0.3,0.6,1.2&nms_radius=3&threshold=none")
    found = method.extract(image, 60)
    direct = ElfRuntime(model).detect(
        image.pixels, scales=(0.3, 0.6, 1.2), nms_radius=3, threshold="none", max_keypoints=60
    )
    assert np.array_equal(found.sizes, direct.sizes)
    assert set(found.sizes.tolist()) == {7, 14, 28}
    assert (found.angles == -1).all()
    assert np.allclose(method.describe(image, found).descriptors, found.descriptors, atol=1e-5)
    assert len(open_method("elf?preset=multiscale", 1).extract(image, 30)) <= 30


def test_oriented_keypoints_with_their_angles(model, image):
    method = open_method(f"elf:{model}?oriented=true")
    found = method.extract(image, 60)
    direct = ElfRuntime(model).detect(image.pixels, oriented=True, max_keypoints=60)
    assert np.array_equal(found.angles, direct.angles)
    assert np.allclose(method.describe(image, found).descriptors, found.descriptors, atol=2e-3)
    turned = replace(found, angles=(found.angles + 180) % 360)
    assert (method.describe(image, turned).descriptors * found.descriptors).sum(axis=1).mean() < 0.9


@pytest.mark.parametrize("option", ["descriptor=pool9", "preset=none", "nms_radius=-1"])
def test_a_setting_that_the_model_refuses_is_named(model, option):
    with pytest.raises(EvalError, match=option.split("=")[1]):
        open_method(f"elf:{model}?{option}")


def test_a_file_that_is_no_elf_model_is_named(tmp_path):
    (tmp_path / "none.onnx").write_bytes(b"not onnx")
    with pytest.raises(EvalError, match=r"none\.onnx"):
        open_method(f"elf:{tmp_path / 'none.onnx'}")


def test_an_image_that_the_model_refuses_is_named(model, tmp_path):
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((16, 16, 3), np.uint8))
    ref = ImageRef("small", tmp_path / "small.png")
    job = Extraction(f"elf:{model}", None, 1, ref, Protocol(size=None), tmp_path)
    with pytest.raises(EvalError, match="small: the image has 16x16 pixels"):
        extract_features(job)
