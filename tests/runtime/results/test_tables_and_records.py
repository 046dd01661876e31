"""Features in .csv files, and records in .npz files."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elf_runtime import ElfError, Features
from elf_runtime.results.features import load_record

from .scattered import scattered


def test_a_table_comes_back(tmp_path: Path) -> None:
    features = scattered(50)
    features.save(tmp_path / "f.csv")
    found = Features.load(tmp_path / "f.csv", image_size=(60, 80))
    for name in ("keypoints", "sizes", "angles"):
        np.testing.assert_allclose(getattr(found, name), getattr(features, name), rtol=0, atol=6e-4)
    np.testing.assert_allclose(found.scores, features.scores, rtol=1e-5)
    assert found.descriptors.shape == (50, 0)
    assert (found.image_size, found.nms_radius, found.record) == ((60, 80), 4.0, None)
    octaves = [[point.octave for point in one.to_cv2()[0]] for one in (found, features)]
    assert octaves[0] == octaves[1]


def test_a_csv_reader_finds_the_columns(tmp_path: Path) -> None:
    features = scattered(5)
    features.save(tmp_path / "f.csv")
    with open(tmp_path / "f.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [list(row) for row in rows] == [["x", "y", "score", "size", "angle"]] * 5
    np.testing.assert_allclose([float(row["x"]) for row in rows], features.keypoints[:, 0], atol=6e-4)
    np.testing.assert_allclose([float(row["score"]) for row in rows], features.scores, rtol=1e-5)


def test_an_angle_just_below_a_whole_turn_and_a_weak_score(tmp_path: Path) -> None:
    features = replace(scattered(1), angles=np.array([359.9999], np.float32), scores=np.array([1.2345e-4], np.float32))
    features.save(tmp_path / "f.csv")
    found = Features.load(tmp_path / "f.csv", (60, 80))
    assert found.angles.tolist() == [0]
    np.testing.assert_allclose(found.scores, 1.2345e-4)


def test_an_empty_table(tmp_path: Path) -> None:
    scattered(0).save(tmp_path / "f.csv")
    assert len(Features.load(tmp_path / "f.csv", (60, 80))) == 0


@pytest.mark.parametrize(
    "text",
    [
        "",
        "1,2,3,4,5\n",
        "x,y,score\n1,2,3\n",
        "x,y,score,size,angle\n1,2,3,4\n",
        "x,y,score,size,angle\n1,2,3,4,a\n",
        "x,y,score,size,angle\n1,2,nan,4,5\n",
        "x,y,score,size,angle\n1,2,3,0,5\n",
        "x,y,score,size,angle\n1,2,3,4,400\n",
        "\xff\xfe",
    ],
)
def test_other_tables(tmp_path: Path, text: str) -> None:
    (tmp_path / "f.csv").write_bytes(text.encode("latin-1"))
    with pytest.raises(ElfError, match=r"f\.csv: "):
        Features.load(tmp_path / "f.csv", (60, 80))


def test_the_image_size_of_a_file(tmp_path: Path) -> None:
    features = scattered(3)
    features.save(tmp_path / "f.csv")
    features.save(tmp_path / "f.npz")
    with pytest.raises(ElfError, match=r"f\.csv: .* give image_size=\(height, width\)$"):
        Features.load(tmp_path / "f.csv")
    with pytest.raises(ElfError, match=r"f\.npz: image_size is \(60, 80\) there, not \(80, 60\)$"):
        Features.load(tmp_path / "f.npz", (80, 60))
    assert Features.load(tmp_path / "f.npz", (60, 80)).image_size == (60, 80)
    for size in ((60,), (60, 0), 60, "60x80", (60.0, 80.0)):
        with pytest.raises(ElfError, match="image_size is"):
            Features.load(tmp_path / "f.csv", size)  # type: ignore[arg-type]
    with pytest.raises(ElfError, match=r"absent\.csv: not a table of features: No such file"):
        Features.load(tmp_path / "absent.csv", (60, 80))


def test_a_record_is_kept_and_can_be_another(tmp_path: Path) -> None:
    features = scattered(3)
    features.save(tmp_path / "own.npz")
    features.save(tmp_path / "given.npz", {"image": "a.jpg"})
    replace(features, record=None).save(tmp_path / "none.npz")
    expected = {"own": features.record, "given": {"image": "a.jpg"}, "none": None}
    for name, record in expected.items():
        assert Features.load(tmp_path / f"{name}.npz").record == load_record(tmp_path / f"{name}.npz") == record
    assert load_record(tmp_path / "absent.npz") is None


@pytest.mark.parametrize("record", [{"path": Path("a")}, {"array": np.zeros(2)}])
def test_a_record_is_plain_data(tmp_path: Path, record: dict[str, Any]) -> None:
    with pytest.raises(ElfError, match="a record is plain data"):
        scattered(3).save(tmp_path / "f.npz", record)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("text", ["{", "[1]", "null"])
def test_a_damaged_record(tmp_path: Path, text: str) -> None:
    scattered(3).save(tmp_path / "f.npz")
    np.savez(tmp_path / "g.npz", **{**np.load(tmp_path / "f.npz"), "record": text})
    with pytest.raises(ElfError, match=r"g\.npz: not a feature file: "):
        Features.load(tmp_path / "g.npz")
    assert load_record(tmp_path / "g.npz") is None


def test_an_archive_is_numpy_s(tmp_path: Path) -> None:
    features = scattered(3)
    features.save(tmp_path / "f.npz")
    with np.load(tmp_path / "f.npz") as data:
        assert sorted(data) == sorted(
            ["keypoints", "scores", "descriptors", "image_size", "nms_radius", "sizes", "angles", "record"]
        )
        assert json.loads(str(data["record"])) == features.record
