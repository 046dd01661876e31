"""ElfRuntime on images and models that it refuses: what is wrong is said, and before any work."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime import ContractError, ElfError, ElfRuntime, ImageError, ModelError, SettingError
from helpers import TINY, textured


@pytest.mark.parametrize(
    ("image", "error"),
    [
        (np.zeros((1, 1, 3), np.uint8), "1x1 pixels; the smallest is 32x32"),
        (np.zeros((31, 400), np.uint8), "smallest is 32x32"),
        (np.zeros((0, 0, 3), np.uint8), "empty"),
        (np.full((64, 64), np.nan), "NaN"),
        (np.full((64, 64, 3), np.inf, np.float32), "infinite"),
        (np.zeros((64, 64), np.int64), "not int64"),
        ("missing.png", "missing.png"),
        ("a\0b.png", r"a\\x00b.png: embedded null byte"),
    ],
)
def test_images_that_are_refused(elf: ElfRuntime, image: object, error: str) -> None:
    for call in (elf.detect, elf.saliency):
        with pytest.raises(ImageError, match=error):
            call(image)  # type: ignore[operator]


def test_what_is_wrong_is_said_of_the_image_that_it_is_wrong_with(
    elf: ElfRuntime, image: np.ndarray, tmp_path: Path
) -> None:
    small = image[:8, :8]
    cv2.imwrite(str(tmp_path / "small.png"), small)
    path = tmp_path / "small.png"
    for call in (elf.detect, elf.saliency, lambda source: elf.describe(source, [(1.0, 1.0)])):
        with pytest.raises(ImageError, match=f"^{re.escape(str(path))}: the image has 8x8 pixels"):
            call(path)
        with pytest.raises(ImageError, match=r"^the image has 8x8 pixels"):
            call(small)
    with pytest.raises(ImageError, match=r"^image 1 of the batch: the image has 8x8 pixels"):
        elf.detect_batch([image, small])
    with pytest.raises(ImageError, match=f"^{re.escape(str(path))}: the image has"):
        elf.detect_batch([image, path])


def test_a_mask_of_another_shape(elf: ElfRuntime, image: np.ndarray) -> None:
    with pytest.raises(ImageError, match=r"mask has shape \(10, 10\), the image \(120, 160\)"):
        elf.detect(image, mask=np.ones((10, 10), bool))


def test_models_that_are_refused(tmp_path: Path) -> None:
    whole = TINY.read_bytes()
    bad = {
        "truncated.onnx": whole[: len(whole) // 2],
        "text.onnx": b"this is not a model\n" * 20,
        "empty.onnx": b"",
        "noise.onnx": np.random.default_rng(0).bytes(5000),
    }
    for name, data in bad.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(ModelError, match=name):
            ElfRuntime(tmp_path / name)
    with pytest.raises(ModelError, match=r"missing\.onnx: no such file"):
        ElfRuntime(tmp_path / "missing.onnx")
    with pytest.raises(ModelError, match="not a file"):
        ElfRuntime(tmp_path)
    with pytest.raises(ModelError, match="0 bytes"):
        ElfRuntime(b"")
    with pytest.raises(ModelError, match="path or bytes"):
        ElfRuntime(7)  # type: ignore[arg-type]


def test_a_model_cut_anywhere_is_refused() -> None:
    whole = TINY.read_bytes()
    for end in np.linspace(1, len(whole) - 1, 40).astype(int):
        with pytest.raises(ModelError):
            ElfRuntime(whole[:end])


def test_a_foreign_model_is_told_apart(tmp_path: Path) -> None:
    """The tiny model with its metadata keys overwritten, byte for byte as long: valid ONNX, no contract."""
    path = tmp_path / "foreign.onnx"
    path.write_bytes(TINY.read_bytes().replace(b"elf.", b"xyz."))
    with pytest.raises(ContractError, match=r"foreign\.onnx: not an ELF model"):
        ElfRuntime(path)


def test_a_contract_at_odds_with_the_graph(tmp_path: Path) -> None:
    path = tmp_path / "odd.onnx"
    path.write_bytes(TINY.read_bytes().replace(b'"descriptors_relu2"', b'"descriptors_relu9"'))
    with pytest.raises(ContractError, match=r"odd\.onnx: 'elf\.descriptors' says output 'descriptors_relu9'"):
        ElfRuntime(path)


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (MemoryError(), "MemoryError"),
        (RuntimeError("no room\nat 0x7f"), "no room"),
        (RuntimeError("x" * 999), "x" * 300),
    ],
)
def test_a_network_that_fails_says_why_in_one_line(
    error: Exception, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Failing:
        def run(self, *_: object) -> None:
            raise error

    elf = ElfRuntime(TINY)
    monkeypatch.setattr(elf._network.sessions, "get", lambda *_, **__: (Failing(), None))
    with pytest.raises(ElfError) as caught:
        elf.detect(textured(64, 80))
    assert str(caught.value) == f"{TINY}: the network failed on a (1, 64, 80, 3) input: {text}"


def test_what_can_t_be_worked_on_is_said_before_any_work(elf: ElfRuntime, image: np.ndarray) -> None:
    with pytest.raises(ImageError, match="the image has 1000000x1000000 pixels, more than the limit of 100,000,000"):
        elf.warmup((10**6, 10**6))
    with pytest.raises(SettingError, match=r"^a batch is a list of images, not 'a\.jpg'; give \['a\.jpg'\]$"):
        elf.detect_batch("a.jpg")
    with pytest.raises(SettingError, match=r"points are all cv2\.KeyPoint, or all \(x, y\)"):
        elf.describe(image, [cv2.KeyPoint(1, 2, 3), (1, 2)])
    with pytest.raises(SettingError, match=r"points are all cv2\.KeyPoint, or all \(x, y\)"):
        elf.describe(image, [(1, 2), cv2.KeyPoint(1, 2, 3)])
