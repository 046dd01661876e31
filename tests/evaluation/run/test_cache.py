"""The cache of features: what is used again, and damaged files."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import SMALL

from elf_eval.data import open_dataset
from elf_eval.methods import open_method, open_methods
from elf_eval.protocol import Protocol
from elf_eval.run.cache import FeatureCache, load


def test_features_come_from_the_cache_until_something_changes(hpatches_folder, resources, monkeypatch):
    method = open_method("orb")
    ref = open_dataset(f"hpatches:{hpatches_folder}").pairs[0].first
    cache = FeatureCache(resources.cache)
    path, made = cache.get(method, ref, SMALL)
    monkeypatch.setattr(method, "extract", lambda *_: pytest.fail("extracted again"))
    assert cache.get(method, ref, SMALL)[1].digest() == made.digest()
    fingerprint = method.fingerprint
    assert cache.path(fingerprint + "x", ref, SMALL) != path
    assert cache.path(fingerprint, ref, Protocol(size=(160, 121), max_keypoints=60)) != path
    assert cache.path(fingerprint, ref, Protocol(size=(160, 120), max_keypoints=61)) != path


def test_a_detector_runs_once_for_all_its_descriptors(hpatches_folder, resources, monkeypatch):
    ref = open_dataset(f"hpatches:{hpatches_folder}").pairs[0].first
    cache = FeatureCache(resources.cache)
    cache.get(open_methods("gftt", "sift"), ref, SMALL)
    other = open_methods("gftt", "orb")
    monkeypatch.setattr(other.detector, "extract", lambda *_: pytest.fail("detected again"))
    _, found = cache.get(other, ref, SMALL)
    direct = open_methods("gftt", "orb").extract(ref.open(SMALL.size), SMALL.max_keypoints)
    assert np.array_equal(found.features.keypoints, direct.keypoints)
    assert np.array_equal(found.features.descriptors, direct.descriptors)


def test_half_a_cache_file_is_made_again(hpatches_folder, resources):
    method = open_method("orb")
    ref = open_dataset(f"hpatches:{hpatches_folder}").pairs[0].first
    cache = FeatureCache(resources.cache)
    path, made = cache.get(method, ref, SMALL)
    for length in (200, 0):
        path.write_bytes(path.read_bytes()[:length])
        assert load(path) is None
    assert cache.get(method, ref, SMALL)[1].digest() == made.digest()


CHANGES = {
    "shapes": {"keypoints": np.zeros((3, 5), np.float32)},
    "types": {"size": np.array(["wide", "high"])},
}


def damage(kind, path):
    """Ways in which a file of the cache goes bad."""
    data = path.read_bytes()
    if kind == "a byte":
        path.write_bytes(data[:150] + bytes([data[150] ^ 255]) + data[151:])
    elif kind == "text":
        path.write_text("nothing of the kind")
    elif kind == "zeros":
        path.write_bytes(bytes(len(data)))
    elif kind == "compression":  # a method of the zip format that Python does not have
        at = data.index(b"PK\x01\x02") + 10
        path.write_bytes(data[:at] + b"\x63" + data[at + 1 :])
    else:
        with np.load(path) as file:
            arrays = dict(file)
        np.savez(path, **{**arrays, **CHANGES[kind]} if kind in CHANGES else {"nothing": np.zeros(3)})


@pytest.mark.parametrize("kind", ["a byte", "text", "zeros", "compression", "shapes", "types", "keys"])
def test_a_damaged_cache_file_is_told_once_and_made_again(kind, hpatches_folder, resources, capsys):
    method = open_method("orb")
    ref = open_dataset(f"hpatches:{hpatches_folder}").pairs[0].first
    cache = FeatureCache(resources.cache)
    path, made = cache.get(method, ref, SMALL)
    damage(kind, path)
    assert cache.get(method, ref, SMALL)[1].digest() == made.digest()
    assert capsys.readouterr().err == f"elf-eval: {path}: a damaged file of the cache; made again\n"
    assert cache.get(method, ref, SMALL)[1].digest() == made.digest()
    assert capsys.readouterr().err == ""


def test_a_cache_that_can_t_be_written_leaves_no_half_file(hpatches_folder, resources, monkeypatch):
    def full(file, **_):
        file.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    ref = open_dataset(f"hpatches:{hpatches_folder}").pairs[0].first
    with pytest.raises(OSError, match="No space"):
        FeatureCache(resources.cache).get(open_method("orb"), ref, SMALL)
    assert [path for path in resources.cache.rglob("*") if path.is_file()] == []
