"""Schemes are fitted to what values are on photographs."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_export.calibration import CalibrationSet, calibration_set
from elf_export.graph.graph import GraphView
from elf_export.precision.int8.ranges import MOST_VALUES, _sample, schemes_for
from elf_export.precision.int8.scheme import fitted
from elf_runtime import InputSpec
from export import small_models as small
from helpers import textured


@pytest.fixture
def pictures(tmp_path: Path) -> CalibrationSet:
    """A dark picture, a bright one and a dark one."""
    for index, (factor, size) in enumerate([(0.2, 40), (1.0, 48), (0.3, 44)]):
        cv2.imwrite(str(tmp_path / f"{index}.png"), np.uint8(textured(size, 64, index) * factor))
    return calibration_set(tmp_path)


def test_schemes_are_fitted_to_the_values_on_all_images_at_the_working_scale(pictures: CalibrationSet) -> None:
    """The image itself, which is the graph's input, needs none."""
    model = small.written("a = Mul(x, third)  b = Sub(x, many)  y = Mul(a, b)",
                          {"third": np.float32(1 / 3), "many": np.float32(200)}, ["N", "H", "W", 3])  # fmt: skip
    spec = InputSpec(name="x", min_size=8)
    found = schemes_for(GraphView(model), ["x", "b", "a"], pictures, spec, 0.5)
    sizes = [(20, 32), (24, 32), (22, 32)]
    pixels = [cv2.imread(str(path)).astype(np.float32) for path in pictures.files]
    halves = [cv2.resize(p, (w, h), interpolation=cv2.INTER_AREA) for p, (h, w) in zip(pixels, sizes, strict=True)]
    every = np.concatenate([half.ravel() for half in halves])
    assert found.keys() == {"a", "b"}
    for name, values in (("a", every * np.float32(1 / 3)), ("b", every - 200)):
        wanted = fitted(np.append(values, np.float32(0)))
        assert found[name].zero == wanted.zero == (128 if name == "b" else 0)
        assert found[name].scale == pytest.approx(wanted.scale, rel=1e-6)


def test_a_sample_of_a_tensor_has_its_extremes() -> None:
    x = np.ones(20 * MOST_VALUES, np.float32)
    x[7], x[8] = -5.0, 9.0
    sample = _sample(x)
    assert (sample.min(), sample.max(), sample.dtype) == (-5.0, 9.0, np.float32)
    assert len(sample) < 1.1 * MOST_VALUES
    assert len(_sample(x[:MOST_VALUES])) >= MOST_VALUES
    assert _sample(x[:0]).tolist() == [0, 0]


@pytest.mark.parametrize("times", [1, 2, 3, 10, 11, 200])
def test_a_sample_sees_even_and_odd_columns_from_first_to_last(times: int) -> None:
    values = np.arange(times * MOST_VALUES, dtype=np.float32)
    sample = _sample(values.reshape(2, -1, 4))[:-2]
    assert abs((sample % 2).mean() - 0.5) < 0.01
    assert abs(sample.mean() / values.mean() - 1) < 0.01
    assert len(sample) >= 0.2 * MOST_VALUES
