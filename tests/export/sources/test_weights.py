"""Weights from every format; the fingerprint proves that they are the same network."""

from __future__ import annotations

import zipfile
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
from elf_export.sources.networks.vgg import OXFORD
from elf_export.sources.weights.fingerprint import fingerprint, mismatches
from elf_export.sources.weights.load import load_weights
from export.sources.vgg_weights import LAYERS, NAMES, TENSORS, VGG, write_h5

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
