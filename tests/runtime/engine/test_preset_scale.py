"""A preset changes the settings, and its working scale is the same for every call."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elf_runtime import ElfRuntime, SettingError, preset
from helpers import TINY


def test_presets_change_the_settings(elf: ElfRuntime, image: np.ndarray) -> None:
    assert elf.params("paper").quantize
    assert elf.params("paper", scale=0.5).scale == 0.5
    assert elf.params("paper-robust").threshold_blur == (17, 6.0)
    elf.detect(image, preset="paper")
    with pytest.raises(SettingError, match=r"unknown preset 'fastest'.*paper"):
        elf.detect(image, preset="fastest")
    with pytest.raises(SettingError, match="unknown detection setting 'radius'"):
        elf.detect(image, radius=3)
    with pytest.raises(SettingError, match="threshold"):
        elf.detect(image, threshold="otsu")
    with pytest.raises(SettingError, match=r"unknown preset \['fast'\]"):
        elf.detect(image, preset=["fast"])  # type: ignore[arg-type]


def test_a_preset_s_scale_is_the_same_for_every_call(elf: ElfRuntime, image: np.ndarray) -> None:
    found = elf.detect(image, preset="fast")
    assert len(found) > 1
    assert np.allclose(elf.describe(image, found.keypoints, preset="fast"), found.descriptors, atol=1e-5)
    assert not np.allclose(elf.describe(image, found.keypoints), found.descriptors, atol=1e-2)
    np.testing.assert_array_equal(elf.saliency(image, preset="fast"), elf.saliency(image, scale=0.33))
    for call in (elf.saliency, lambda image, preset: elf.describe(image, [[5, 5]], preset=preset)):
        with pytest.raises(SettingError, match="unknown preset 'fastest'"):
            call(image, preset="fastest")


def test_a_preset_s_scale_is_not_for_a_model_of_one_size(monkeypatch: pytest.MonkeyPatch, image: np.ndarray) -> None:
    elf = ElfRuntime(TINY, threads=1)
    spec = replace(elf.contract.input, height=60, width=80)
    monkeypatch.setattr(elf._network, "contract", replace(elf.contract, input=spec))
    for name in ("fast", "accurate", "multiscale"):
        assert elf.trace(image, preset=name).saliency.shape == (60, 80)
        assert elf.params(name) == preset(name).updated(scale=1.0)
        with pytest.raises(SettingError, match=r"80x60 \(width x height\) only.*scale 0.28 can't be chosen"):
            elf.detect(image, preset=name, scale=0.28)
        with pytest.raises(SettingError, match=r"80x60 \(width x height\) only.*scale 0.9 can't be chosen"):
            elf.detect(image, preset=name, scales=(0.45, 0.9))
    assert np.unique(elf.detect(image, scales=(1.0,)).sizes).size == 1
