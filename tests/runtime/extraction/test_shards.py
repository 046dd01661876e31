"""Shards hold what was put in, are whole or absent, and are reached where fsspec does."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elf_runtime.errors import ElfError
from elf_runtime.extraction.shard_worker import MOST_DEATHS, _Notes
from elf_runtime.extraction.shards import contents, digest, read_shards, without, write_shard
from elf_runtime.extraction.store import Store, is_url, needed
from elf_runtime.results.features import Features

SHARD = "part-0001-0123456789ab-00000"
COLUMNS = ("keypoints", "scores", "descriptors", "sizes", "angles")


def features(count: int, length: int = 4, seed: int = 0) -> Features:
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((count, length)).astype(np.float32)
    rows /= np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-9)
    return Features(
        rng.uniform(0, 50, (count, 2)).astype(np.float32), -np.sort(-rng.random(count)).astype(np.float32), rows,
        (60, 80), nms_radius=5.0, sizes=rng.uniform(1, 9, count), angles=rng.uniform(0, 359, count),
        record={"image": f"/photos/{seed}.jpg", "image_sha256": f"{seed:064d}", "settings": {"grid": None}},
    )  # fmt: skip


def same(a: Features, b: Features) -> None:
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
        assert getattr(b, name).dtype == np.float32
    assert (a.image_size, dict(a.record or {})) == (b.image_size, dict(b.record or {}))


@pytest.fixture
def store(tmp_path: Path) -> Store:
    pytest.importorskip("fsspec", reason="needs the extra ray")
    pytest.importorskip("pyarrow", reason="needs the extra ray")
    return Store.at(str(tmp_path / "shards"))


@pytest.fixture(params=["parquet", "h5"])
def ending(request: pytest.FixtureRequest) -> str:
    if request.param == "h5":
        pytest.importorskip("h5py")
    return str(request.param)


def test_what_is_written_is_read(store: Store, ending: str) -> None:
    """Also an image without keypoints, and one without descriptors."""
    rows = {"a/1.jpg": features(7), "a/2.jpg": features(0, seed=1), "b.png": features(3, length=0, seed=2)}
    write_shard(store, f"{SHARD}.{ending}", rows)
    found = dict(read_shards(store.path))
    assert list(found) == list(rows)
    for name, expected in rows.items():
        same(expected, found[name])
    assert found["a/1.jpg"].nms_radius == 5.0 or ending == "h5"  # of which hloc's files know nothing
    assert dict(read_shards(f"{store.path}/{SHARD}.{ending}")).keys() == rows.keys()
    assert contents(store) == {name: {f"{SHARD}.{ending}": digest(row.record)} for name, row in rows.items()}


def test_a_table_is_as_it_is_documented(store: Store) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = {"a/1.jpg": features(5), "b.png": features(2, seed=3)}
    write_shard(store, f"{SHARD}.parquet", rows)
    table = parquet.read_table(f"{store.path}/{SHARD}.parquet")
    types = {name: str(kind) for name, kind in zip(table.schema.names, table.schema.types, strict=True)}
    assert list(types) == [
        "name", "image", "sha256", "height", "width", "nms_radius", "keypoints", "scores", "sizes", "angles",
        "descriptors", "descriptor_length", "record",
    ]  # fmt: skip
    assert types["keypoints"].count("fixed_size_list") == 1
    first = table.to_pylist()[0]
    np.testing.assert_array_equal(np.array(first["keypoints"], np.float32), rows["a/1.jpg"].keypoints)
    vectors = np.frombuffer(first["descriptors"], "<f4").reshape(-1, first["descriptor_length"])
    np.testing.assert_array_equal(vectors, rows["a/1.jpg"].descriptors)
    assert (first["image"], first["sha256"]) == ("/photos/0.jpg", "0" * 64)
    assert (first["height"], first["width"]) == (60, 80)


def test_hloc_reads_a_shard(store: Store) -> None:
    pytest.importorskip("h5py")
    from elf_runtime.results.hloc import read_features

    write_shard(store, f"{SHARD}.h5", {"a/1.jpg": features(5)})
    np.testing.assert_array_equal(read_features(f"{store.path}/{SHARD}.h5")["a/1.jpg"].keypoints, features(5).keypoints)


def test_descriptors_in_8_bits_are_restored(store: Store) -> None:
    whole = features(6, length=64)
    write_shard(store, f"{SHARD}.parquet", {"1": whole.quantized()})
    ((_, found),) = read_shards(store.path)
    np.testing.assert_allclose(found.descriptors, whole.descriptors, atol=0.01)


def test_images_are_taken_out_of_a_shard(store: Store, ending: str) -> None:
    rows = {name: features(3, seed=index) for index, name in enumerate("abc")}
    write_shard(store, f"{SHARD}.{ending}", rows)
    without(store, f"{SHARD}.{ending}", {"b"})
    found = dict(read_shards(store.path))
    assert list(found) == ["a", "c"]
    same(rows["c"], found["c"])
    without(store, f"{SHARD}.{ending}", {"a", "c"})
    assert store.shards() == []


def test_a_write_that_fails_leaves_what_was_there(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    write_shard(store, f"{SHARD}.parquet", {"a": features(3)})

    def fails(*_: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(type(store.system), "mv", fails)
    with pytest.raises(ElfError, match="no space left"):
        write_shard(store, f"{SHARD}.parquet", {"b": features(3)})
    assert store.names() == [f"{SHARD}.parquet"]
    assert [name for name, _ in read_shards(store.path)] == ["a"]


def test_an_object_store_gets_a_file_in_one_piece(
    store: Store, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """There a renaming is a copy, and a file appears when it is whole."""
    (tmp_path / "text").write_text("whole")
    monkeypatch.setattr(type(store.system), "protocol", ("s3", "file"))
    monkeypatch.setattr(type(store.system), "mv", None)
    store.put(tmp_path / "text", "name")
    assert store.text("name") == "whole"


def test_what_is_no_shard_is_said(store: Store, tmp_path: Path) -> None:
    with pytest.raises(ElfError, match="no shards"):
        list(read_shards(store.path))
    store.put_text("nothing", f"{SHARD}.parquet")
    with pytest.raises(ElfError, match="not a shard of features"):
        list(read_shards(store.path))
    with pytest.raises(ElfError, match="not a shard of features"):
        contents(store)
    with pytest.raises(ElfError, match="nowhere"):
        Store.at("nowhere://bucket")


def test_an_image_is_blamed_for_workers_that_touched_it_last(store: Store) -> None:
    """The first worker of a shard takes no care; the next ones note each image before they touch it."""
    first = _Notes(store, "note")
    first.add_careful("a")  # nothing: it need not take care
    assert (first.deaths, first.killed("a")) == (0, 0)
    for died in range(1, MOST_DEATHS + 1):
        notes = _Notes(store, "note")
        assert (notes.deaths, notes.killed("b")) == (died, died - 1)
        notes.add_careful("a")
        notes.add_careful("b")
    last = _Notes(store, "note")
    assert (last.killed("a"), last.killed("b")) == (0, MOST_DEATHS)
    last.remove()
    assert _Notes(store, "note").deaths == 0


@pytest.mark.parametrize("module", ["ray", "pyarrow", "fsspec.core"])
def test_what_is_missing_is_named_with_its_extra(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ElfError, match=rf"{module.partition('.')[0]}.*elf-onnx\[ray\]"):
        needed(module)


@pytest.mark.parametrize(
    ("place", "expected"),
    [("s3://bucket/a", True), ("gs://b", True), ("zip::s3://b/a.zip", True), ("a/b.jpg", False), ("C:\\a.jpg", False)],
)
def test_urls_are_told_from_paths(place: str, expected: bool) -> None:
    assert is_url(place) is expected
    assert not is_url(Path(place))


def test_features_without_a_record_can_be_shards(store: Store, ending: str) -> None:
    bare: Any = replace(features(2), record=None)
    write_shard(store, f"{SHARD}.{ending}", {"1": bare})
    ((name, found),) = read_shards(store.path)
    assert name == "1"
    np.testing.assert_array_equal(found.scores, bare.scores)
