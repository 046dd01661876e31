"""Models in ORT format: written from .onnx files, and run with the same results."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from elf_runtime import ElfRuntime, ModelError, to_ort
from elf_runtime.commands.info import main
from elf_runtime.model.ort_format import is_ort_format
from helpers import TINY, textured

IMAGES = [textured(96, 128), textured(75, 101, seed=1)]


@pytest.fixture(scope="module", params=[False, True], ids=["portable", "this_machine"])
def converted(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return to_ort(TINY, tmp_path_factory.mktemp("ort") / "tiny.ort", this_machine=request.param)


@pytest.mark.parametrize("image", IMAGES, ids=["even", "odd"])
def test_the_results_are_those_of_the_onnx_file(converted: Path, image: np.ndarray) -> None:
    onnx, ort = ElfRuntime(TINY), ElfRuntime(converted)
    a, b = onnx.trace(image), ort.trace(image)
    np.testing.assert_allclose(b.saliency, a.saliency, atol=1e-5 * a.saliency.max())
    np.testing.assert_allclose(b.features.keypoints, a.features.keypoints, atol=1e-3)
    np.testing.assert_allclose(b.features.descriptors, a.features.descriptors, atol=1e-5)
    np.testing.assert_allclose(ort.saliency(image), onnx.saliency(image), atol=1e-5 * a.saliency.max())
    points = a.features.keypoints
    for layer in ("relu2", "pool1"):
        np.testing.assert_allclose(ort.describe(image, points, layer), onnx.describe(image, points, layer), atol=1e-5)


def test_the_contract_survives(converted: Path) -> None:
    assert ElfRuntime(converted).contract == ElfRuntime(TINY).contract


def test_one_session_serves_all_sizes_and_outputs(converted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    elf = ElfRuntime(converted, sizes=4)
    monkeypatch.setattr("elf_runtime.model.sessions.open_session", None)  # another call would raise
    for image in IMAGES:
        elf.detect(image)
        elf.saliency(image)
    batch = elf.detect_batch([IMAGES[0], IMAGES[0]])
    np.testing.assert_array_equal(batch[0].keypoints, batch[1].keypoints)


def test_bytes_are_a_model_too(converted: Path) -> None:
    assert len(ElfRuntime(converted.read_bytes()).detect(IMAGES[0]))


def test_the_formats_are_told_apart(converted: Path, tmp_path: Path) -> None:
    assert is_ort_format(converted)
    assert is_ort_format(converted.read_bytes())
    assert not is_ort_format(TINY)
    assert not is_ort_format(b"ORTM")
    assert not is_ort_format(tmp_path / "absent.ort")
    assert not is_ort_format(tmp_path)


def test_a_damaged_file_is_refused(converted: Path, tmp_path: Path) -> None:
    data = converted.read_bytes()
    for end in (9, 200, len(data) // 2):
        (tmp_path / "cut.ort").write_bytes(data[:end])
        with pytest.raises(ModelError, match=r"cut\.ort"):
            ElfRuntime(tmp_path / "cut.ort")


def test_a_foreign_model_is_no_elf_model(tmp_path: Path) -> None:
    (tmp_path / "other.onnx").write_bytes(TINY.read_bytes().replace(b"elf.", b"alf."))
    with pytest.raises(ModelError, match="not an ELF model"):
        to_ort(tmp_path / "other.onnx", tmp_path / "other.ort")
    assert not (tmp_path / "other.ort").exists()


def test_what_can_not_be_written_leaves_nothing(converted: Path, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"ends in \.ort"):
        to_ort(TINY, tmp_path / "tiny.onnx")
    with pytest.raises(ModelError, match="already"):
        to_ort(converted, tmp_path / "again.ort")
    with pytest.raises(ModelError, match="can't write"):
        to_ort(TINY, tmp_path / "absent" / "tiny.ort")
    broken = TINY.read_bytes().replace(b"HardSigmoid", b"HardSigmoix").replace(b"MaxPool", b"MaxPoox")
    (tmp_path / "broken.onnx").write_bytes(broken)
    (tmp_path / "old.ort").write_bytes(b"old")
    with pytest.raises(ModelError, match="can't write"):
        to_ort(tmp_path / "broken.onnx", tmp_path / "old.ort")
    assert (tmp_path / "old.ort").read_bytes() == b"old"
    assert {path.name for path in tmp_path.iterdir()} == {"broken.onnx", "old.ort"}


def test_elf_info_writes_and_shows_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "tiny.ort"
    assert main([str(TINY), "--provider", "cpu", "--ort", str(target)]) == 0
    assert f"wrote {target}" in capsys.readouterr().out
    assert main([str(target)]) == 0
    text = capsys.readouterr().out
    assert "tiny pool1" in text
    assert "in ORT format" in text
    assert "runs every op" in text
    assert main([str(target), "--provider", "cpu", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["graph"] is None
    assert report["contract"]["network"] == "tiny"
    assert main([str(TINY), "--this-machine"]) == 2
    assert "--this-machine is for the file that --ort names" in capsys.readouterr().err
