"""hloc's and COLMAP's files, read as these programs read them."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elf_runtime import ElfError, Matches, SettingError
from elf_runtime.results.colmap import write_colmap_matches, write_colmap_text
from elf_runtime.results.hloc import read_features, read_matches, write_features, write_matches

from .scattered import scattered

PAIRS = np.array([[0, 4], [2, 1], [6, 0]])


@pytest.fixture
def h5py() -> Any:
    return pytest.importorskip("h5py")


def test_hloc_finds_its_features(h5py: Any, tmp_path: Path) -> None:
    a, b = scattered(7), scattered(5, seed=1).quantized()
    write_features(tmp_path / "f.h5", {"a.jpg": a, "db/b.jpg": b}, uncertainty=1.5)
    with h5py.File(tmp_path / "f.h5", "r") as file:
        for name, features in (("a.jpg", a), ("db/b.jpg", b)):
            group = file[name]
            np.testing.assert_array_equal(group["keypoints"].__array__(), features.keypoints)
            assert group["keypoints"].attrs.get("uncertainty") == 1.5
            assert group["descriptors"].shape == (16, len(features))
            assert group["descriptors"].dtype == np.float32
            np.testing.assert_allclose(np.linalg.norm(group["descriptors"], axis=0), 1, atol=1e-6)
            assert group["image_size"][:].tolist() == [80, 60]
    write_features(tmp_path / "g.h5", {"a.jpg": a})
    with h5py.File(tmp_path / "g.h5", "r") as file:
        assert "uncertainty" not in file["a.jpg"]["keypoints"].attrs
        np.testing.assert_array_equal(file["a.jpg"]["descriptors"], a.descriptors.T)


def test_features_come_back(h5py: Any, tmp_path: Path) -> None:
    given = {"db/x/a.jpg": scattered(7), "b.jpg": scattered(0)}
    write_features(tmp_path / "f.h5", given)
    found = read_features(tmp_path / "f.h5")
    assert found.keys() == given.keys()
    for name, features in given.items():
        for column in ("keypoints", "scores", "descriptors", "sizes", "angles"):
            np.testing.assert_array_equal(getattr(found[name], column), getattr(features, column))
        assert found[name].image_size == (60, 80)
    assert found["db/x/a.jpg"].nms_radius == 4


def test_features_of_another_extractor(h5py: Any, tmp_path: Path) -> None:
    rows = np.random.default_rng(0).standard_normal((8, 3)).astype(np.float16)
    with h5py.File(tmp_path / "f.h5", "w") as file:
        group = file.create_group("a.jpg")
        group["keypoints"], group["image_size"] = np.ones((3, 2), np.float16), np.array([80, 60])
        group["descriptors"], group["scores"] = rows, np.array([0.1, 0.9, 0.5], np.float16)
        file.create_group("b.jpg")["keypoints"] = np.ones((2, 2), np.float32)
        file["b.jpg"]["image_size"] = np.array([80, 60])
    found = read_features(tmp_path / "f.h5")
    np.testing.assert_array_equal(found["a.jpg"].descriptors, rows.T.astype(np.float32))
    assert found["a.jpg"].scores.argmax() == 1
    assert found["b.jpg"].descriptors.shape == (2, 0)
    assert found["b.jpg"].scores.tolist() == [1, 1]


@pytest.mark.parametrize(
    "changed",
    [
        {"keypoints": np.ones((3, 3))},
        {"keypoints": np.array([b"a"])},
        {"image_size": np.array([80])},
        {"image_size": None},
        {"scores": np.ones(4)},
        {"descriptors": np.ones((3, 16))},
        {"sizes": np.zeros(3)},
    ],
)
def test_features_that_do_not_fit(h5py: Any, tmp_path: Path, changed: dict[str, Any]) -> None:
    arrays = {"keypoints": np.ones((3, 2)), "image_size": np.array([80, 60]), **changed}
    with h5py.File(tmp_path / "f.h5", "w") as file:
        for name, values in arrays.items():
            if values is not None:
                file[f"a.jpg/{name}"] = values
    with pytest.raises(ElfError, match=r"f\.h5: a\.jpg: "):
        read_features(tmp_path / "f.h5")


def test_other_files(h5py: Any, tmp_path: Path) -> None:
    (tmp_path / "f.h5").write_text("x,y")
    for path, read in ((tmp_path / "f.h5", read_features), (tmp_path / "absent.h5", read_matches)):
        with pytest.raises(ElfError, match=r"\.h5: not an HDF5 file: "):
            read(path)
    for name in ("", "/"):
        with pytest.raises(ElfError, match="no name for a group"):
            write_features(tmp_path / "g.h5", {name: scattered(3)})
    with pytest.raises(ElfError, match="no name for a group"):
        write_features(tmp_path / "g.h5", {"a": scattered(3), "a/keypoints": scattered(3)})
    assert [path.name for path in tmp_path.iterdir()] == ["f.h5"]


def test_hloc_finds_its_matches(h5py: Any, tmp_path: Path) -> None:
    scores = np.array([0.7, 0.9, 0.8], np.float32)
    matches = Matches(PAIRS, scores, np.full(3, 0.5, np.float32))
    write_matches(tmp_path / "m.h5", {("db/a.jpg", "b.jpg"): (matches, 8), ("b.jpg", "c.jpg"): (PAIRS, 7)})
    with h5py.File(tmp_path / "m.h5", "r") as file:
        group = file["db-a.jpg/b.jpg"]
        assert group["matches0"].__array__().tolist() == [4, -1, 1, -1, -1, -1, 0, -1]
        np.testing.assert_allclose(group["matching_scores0"].__array__(), [0.7, 0, 0.9, 0, 0, 0, 0.8, 0], rtol=1e-6)
        assert file["b.jpg/c.jpg"]["matching_scores0"][:].tolist() == [1, 0, 1, 0, 0, 0, 1]
    found, count = read_matches(tmp_path / "m.h5")["db-a.jpg", "b.jpg"]
    assert count == 8
    assert found.indices.tolist() == [[2, 1], [6, 0], [0, 4]]
    np.testing.assert_allclose(found.similarity, [0.9, 0.8, 0.7], rtol=1e-6)
    assert list(read_matches(tmp_path / "m.h5")) == [("b.jpg", "c.jpg"), ("db-a.jpg", "b.jpg")]


def test_matches_one_pair_at_a_time(h5py: Any, tmp_path: Path) -> None:
    write_matches(tmp_path / "m.h5", ((("a", str(i)), (PAIRS[:i], 7)) for i in range(4)))
    assert [len(matches) for matches, _ in read_matches(tmp_path / "m.h5").values()] == [0, 1, 2, 3]


def test_matches_that_do_not_fit(h5py: Any, tmp_path: Path) -> None:
    for pairs, count in ((PAIRS, 6), (PAIRS[:, [1, 1]].clip(0, 0), 7), (PAIRS - 1, 7), (PAIRS * 1.0, 7), (PAIRS[0], 7)):
        with pytest.raises(SettingError, match="matches"):
            write_matches(tmp_path / "m.h5", {("a", "b"): (pairs, count)})
    with pytest.raises(ElfError, match="a-b/c: hloc writes / as -"):
        write_matches(tmp_path / "m.h5", {("a/b", "c"): (PAIRS, 7), ("a-b", "c"): (PAIRS, 7)})
    assert not list(tmp_path.iterdir())
    with h5py.File(tmp_path / "n.h5", "w") as file:
        file["a/b/matches0"], file["a/b/matching_scores0"] = np.zeros(3, np.int32), np.zeros(2)
    with pytest.raises(ElfError, match=r"n\.h5: a/b: matches0"):
        read_matches(tmp_path / "n.h5")


def test_without_h5py_it_is_said_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    calls = (
        lambda: write_features(tmp_path / "f.h5", {}),
        lambda: read_features(tmp_path / "f.h5"),
        lambda: write_matches(tmp_path / "f.h5", {}),
        lambda: read_matches(tmp_path / "f.h5"),
    )
    for call in calls:
        with pytest.raises(ElfError, match=r"need h5py, .* pip install 'elf-onnx\[h5\]'"):
            call()


def test_colmap_s_keypoints(tmp_path: Path) -> None:
    features = replace(scattered(3), sizes=np.array([18, 9, 36], np.float32), angles=np.array([-1, 90, 0], np.float32))
    write_colmap_text(tmp_path / "a.jpg.txt", features)
    header, *lines = (tmp_path / "a.jpg.txt").read_text().splitlines()
    assert header == "3 128"
    rows = [[float(word) for word in line.split(" ")] for line in lines]
    for row, (x, y), scale, angle in zip(rows, features.keypoints, (2, 1, 4), (0, np.pi / 2, 0), strict=True):
        np.testing.assert_allclose(row[:4], [x + 0.5, y + 0.5, scale, angle], atol=1e-3)
        assert row[4:] == [0] * 128
    write_colmap_text(tmp_path / "none.txt", scattered(0))
    assert (tmp_path / "none.txt").read_text() == "0 128\n"


def test_colmap_s_matches(tmp_path: Path) -> None:
    write_colmap_matches(tmp_path / "m.txt", {("a.jpg", "s/b.jpg"): PAIRS[::-1], ("a.jpg", "c.jpg"): PAIRS[:0]})
    assert (tmp_path / "m.txt").read_text() == "a.jpg s/b.jpg\n0 4\n2 1\n6 0\n\na.jpg c.jpg\n\n"
    with pytest.raises(ElfError, match=r"^a b\.jpg: COLMAP's lists have no names with spaces$"):
        write_colmap_matches(tmp_path / "n.txt", {("a b.jpg", "c.jpg"): PAIRS})
    with pytest.raises(SettingError, match="indices below 0"):
        write_colmap_matches(tmp_path / "n.txt", {("a.jpg", "c.jpg"): PAIRS - 1})
    assert [path.name for path in tmp_path.iterdir()] == ["m.txt"]
