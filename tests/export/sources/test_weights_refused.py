"""Files of weights that are refused: broken, of another network, unsafe, or too long to wait for."""

from __future__ import annotations

import os
import time
import zipfile
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch

from elf_export import WeightsError
from elf_export.sources.weights.fingerprint import fingerprint
from elf_export.sources.weights.load import load_weights
from export.sources.vgg_weights import LAYERS, TENSORS, VGG, write_h5


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
