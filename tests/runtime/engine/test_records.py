"""The record of where features come from."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import elf_runtime
from elf_runtime import ElfRuntime, Features
from helpers import TINY, textured


@pytest.fixture(scope="module")
def elf() -> ElfRuntime:
    return ElfRuntime(TINY, threads=1)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    cv2.imwrite(str(tmp_path / "a.png"), textured(64, 96))
    return tmp_path / "a.png"


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def expected(elf: ElfRuntime, **settings: Any) -> dict[str, Any]:
    params = json.loads(json.dumps(elf.params(**settings).to_dict()))
    return {
        "model": str(TINY),
        "model_sha256": digest(TINY),
        "network": "tiny",
        "layer": "pool1",
        "descriptor": "relu2",
        "settings": params,
        "elf-onnx": elf_runtime.__version__,
    }


def test_of_a_file_and_of_an_array(elf: ElfRuntime, path: Path) -> None:
    of_file = {"image": os.path.realpath(path), "image_sha256": digest(path)}
    for given in (path, str(path)):
        assert elf.detect(given, nms_radius=4).record == of_file | expected(elf, nms_radius=4)
    assert elf.trace(path).features.record == of_file | expected(elf)
    assert elf.detect(textured(64, 96)).record == expected(elf)
    flat = elf.detect(np.zeros((40, 50), np.uint8), descriptor="pool1")
    assert (len(flat), flat.record) == (0, expected(elf) | {"descriptor": "pool1"})


def test_of_a_batch_each_has_its_own(elf: ElfRuntime, path: Path) -> None:
    other = path.with_name("b.png")
    cv2.imwrite(str(other), np.zeros((64, 96), np.uint8))
    found = elf.detect_batch([path, textured(64, 96), other, textured(40, 50), path])
    images = [(one.record or {}).get("image") for one in found]
    assert images == [os.path.realpath(path), None, os.path.realpath(other), None, os.path.realpath(path)]
    assert (found[2].record or {})["image_sha256"] == digest(other)


def test_it_is_plain_data_that_a_file_keeps(elf: ElfRuntime, path: Path, tmp_path: Path) -> None:
    features = elf.detect(path, scales=(0.5, 1.0), grid=(2, 3))
    assert json.loads(json.dumps(features.record)) == features.record
    features[:5].save(tmp_path / "f.npz")
    found = Features.load(tmp_path / "f.npz")
    assert len(found) == 5
    assert found.record == features.record


def test_the_bundled_model_has_no_path() -> None:
    elf = ElfRuntime(threads=1)
    record = elf.detect(textured(64, 96)).record or {}
    assert (record["model"], record["model_sha256"]) == ("bundled", elf.sha256)
