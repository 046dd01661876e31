"""The examples of docs/library.md, run as they stand there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime as ort
import pytest

from elf_export import LayerError, build_gradient
from export import small_models as small
from helpers import ROOT

EXAMPLES = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "library.md").read_text(), re.DOTALL)


@pytest.fixture
def names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the examples leave to the reader."""
    onnx.save(small.classifier(), tmp_path / "classifier.onnx")
    monkeypatch.chdir(tmp_path)
    image = np.random.default_rng(0).standard_normal((1, 3, 40, 48)).astype(np.float32)
    return {"CLASSES": 5, "CLASS": 2, "EPSILON": np.float32(1e-3), "image": image}


def logits(image: np.ndarray) -> np.ndarray:
    values: np.ndarray = ort.InferenceSession("classifier.onnx").run(None, {"x": image})[0]
    return values


def test_the_saliency_of_a_class(names: dict[str, Any]) -> None:
    exec(EXAMPLES[0], names)
    saliency = names["saliency"]
    assert saliency.shape == (1, 40, 48)
    model = build_gradient(small.classifier(), "logits", seed=names["one_hot"])
    (gradient,) = ort.InferenceSession(model.SerializeToString()).run(["gradient"], {"x": names["image"]})
    assert np.allclose(saliency, np.abs(gradient).mean(1), atol=1e-7)
    step = 1e-2 * gradient / np.linalg.norm(gradient)
    change = logits(names["image"] + step) - logits(names["image"] - step)
    assert change[0, 2] / 2e-2 == pytest.approx(np.linalg.norm(gradient), rel=1e-2)


def test_an_attack_lowers_the_class(names: dict[str, Any]) -> None:
    exec(EXAMPLES[1], names)
    before, after = logits(names["image"]), logits(names["attacked"])
    loss = [np.log(np.exp(z).sum()) - z[0, 2] for z in (before, after)]
    predicted = 1e-3 * np.abs(names["gradient"]).sum()
    assert loss[1] - loss[0] == pytest.approx(predicted, rel=0.05)


def test_a_seed_s_name_must_be_free() -> None:
    with pytest.raises(LayerError, match="can't be called 'pool1'"):
        build_gradient(small.classifier(), "logits", seed="pool1")


def test_there_are_two_examples() -> None:
    assert len(EXAMPLES) == 2
