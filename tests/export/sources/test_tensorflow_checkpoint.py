"""TensorFlow's checkpoints, read without it; LF-Net by one command, and at work in the paper's suite."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from elf_export import WeightsError
from elf_export.cli import main as export
from elf_export.sources.networks import get_network
from elf_export.sources.weights.formats import read_tensors
from elf_runtime import ElfRuntime
from export.sources.tensorflow_checkpoints import write_checkpoint
from helpers import textured
from seeded import seeded_weights


def some_tensors() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    named = {f"scope/block-{n}/conv/weights": rng.normal(size=(3, 3, n + 1, 4)).astype(np.float32) for n in range(40)}
    return named | {"global_step": np.array(12345, np.int64), "decay": np.array([0.5, 0.25])}


def test_every_tensor_comes_back(tmp_path: Path) -> None:
    tensors = some_tensors()
    found = read_tensors(write_checkpoint(tmp_path, "model-7", tensors))
    assert found.keys() == tensors.keys()
    assert all(np.array_equal(found[name], tensors[name]) for name in tensors)
    assert found["decay"].dtype == np.float64


def test_what_is_missing_or_damaged_is_named(tmp_path: Path) -> None:
    index = write_checkpoint(tmp_path, "m", some_tensors())
    data = tmp_path / "m.data-00000-of-00001"
    data.write_bytes(data.read_bytes()[:-50])
    with pytest.raises(WeightsError, match=r"m\.index: .*: its data file ends before it, or is another checkpoint's"):
        read_tensors(index)
    data.unlink()
    with pytest.raises(WeightsError, match=r"m\.data-00000-of-00001: no such file; .* beside m\.index"):
        read_tensors(index)
    whole = index.read_bytes()
    for broken in (whole[:100] + whole[-48:], whole[:40] + b"\xff" * 40 + whole[80:]):
        index.write_bytes(broken)
        with pytest.raises(WeightsError, match=r"m\.index"):
            read_tensors(index)


def lfnet_checkpoint(folder: Path) -> Path:
    """LF-Net's variables under the names and in the layout of its release, beside others."""
    network = get_network("lfnet")
    roles = {"weight": "gamma", "bias": "beta", "running_mean": "moving_mean", "running_var": "moving_variance"}
    variables: dict[str, np.ndarray] = {"SimpleDesc/block-1/conv1/weights": np.full((5, 5, 16, 16), 9.0, np.float32)}
    for name, value in seeded_weights(network.tensor_shapes(network.layers)).items():
        part, role = name.rsplit(".", 1)
        scope = f"ConvOnlyResNet/{part.replace('.', '/')}"
        if part.endswith("-bn"):
            variables[f"{scope}/{roles[role]}"] = value.astype(np.float32)
        elif value.ndim == 4:
            variables[f"{scope}/weights"] = np.ascontiguousarray(value.transpose(2, 3, 1, 0), np.float32)
            variables[f"{scope}/weights/Adam"] = np.zeros(value.shape[2:] + value.shape[1::-1], np.float32)
    return write_checkpoint(folder, "models-latest", variables)


@pytest.mark.parametrize("layer", ["block2-bn", "block2-conv"])
def test_lf_net_by_one_command(layer: str, tmp_path: Path) -> None:
    out = tmp_path / "elf-lfnet.onnx"
    index = lfnet_checkpoint(tmp_path)
    assert export(["--net", "lfnet", "--layer", layer, "--desc", "none", "--weights", str(index), "-o", str(out)]) == 0
    elf = ElfRuntime(out)
    assert (elf.contract.network, elf.contract.layer) == ("lfnet", layer)
    assert len(elf.detect(textured(120, 160), preset="paper")) > 0
    network = get_network("lfnet")
    shapes = network.tensor_shapes([layer])
    fitted, seeded = network.fit(read_tensors(index), shapes), seeded_weights(network.tensor_shapes(network.layers))
    kernels = [name for name in shapes if name.endswith("conv1.weight")]
    assert kernels
    assert all(np.array_equal(fitted[name], seeded[name].astype(np.float32)) for name in kernels)


@pytest.mark.parametrize("ending", ["", ".data-00000-of-00001", ".meta"])
def test_a_checkpoint_is_named_by_its_index(ending: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """TensorFlow's own tools take the prefix alone."""
    index = lfnet_checkpoint(tmp_path)
    (tmp_path / "models-latest.meta").write_bytes(b"\n\x05graph" * 20)
    given = tmp_path / f"models-latest{ending}"
    command = ["--net", "lfnet", "--desc", "none", "--weights", str(given), "-o", str(tmp_path / "o.onnx")]
    assert export(command) == 1
    error = capsys.readouterr().err
    assert error.strip().endswith(f"which is named by its index: {index}")
    index.unlink()
    assert export(command) == 1
    assert "named by its index" not in capsys.readouterr().err
