"""The committed test model is the one that its script makes."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from elf_runtime import ElfRuntime

DATA = Path(__file__).parents[1] / "data"


@pytest.mark.torch
def test_tiny_model_is_what_its_script_makes() -> None:
    pytest.importorskip("onnx")
    spec = importlib.util.spec_from_file_location("make_tiny", DATA / "make_tiny.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    # By what it computes and says of itself: the exporter may find better nodes for the same function.
    made, committed = ElfRuntime(script.tiny().SerializeToString()), ElfRuntime(DATA / "tiny.onnx")
    assert made.contract == committed.contract
    image = np.random.default_rng(0).integers(0, 256, (49, 64, 3), np.uint8)
    np.testing.assert_allclose(made.saliency(image), committed.saliency(image), atol=1e-5)


def test_tiny_model_detects_and_describes() -> None:
    elf = ElfRuntime(DATA / "tiny.onnx")
    image = np.random.default_rng(0).integers(0, 256, (96, 128), np.uint8)
    features = elf.detect(image)
    assert len(features) > 10
    assert features.descriptors.shape == (len(features), 8)
