"""What mutants go through: the runtime, elf-info, elf-detect, and, where onnx is installed, elf-export."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from elf_runtime import ElfRuntime, ImageError
from elf_runtime.commands.detect import main as detect
from elf_runtime.commands.info import main as info
from elf_runtime.model import bundled_model
from helpers import TINY, textured

from . import images, wire
from .trial import command

Job = tuple[str, Callable[[], None]]
IMAGE = textured(66, 71)
# Pixels of an image: one that is whole and larger needs what detection needs, some 300 bytes a pixel at full size.
LARGEST = 4_000_000


def elf_models(seed: int, limit: int) -> Iterator[Job]:
    """Mutants of ELF models through the runtime and elf-info."""
    whole = {"tiny": TINY.read_bytes(), "int8": bundled_model("int8").read_bytes()}
    sources = {name: wire.mutants(data, seed + i) for i, (name, data) in enumerate(whole.items())}
    for number in range(limit):
        name = "int8" if number % 4 == 3 else "tiny"
        what, data = next(sources[name])
        yield f"ELF model {name}, {number}: {what}", lambda data=data, number=number: _elf_model(data, number)


def _elf_model(data: bytes, number: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "model.onnx")
        path.write_bytes(data)
        if number % 2:
            command(info, [str(path), "--provider", "cpu"])
            return
        elf = ElfRuntime(path, threads=1)
        found = elf.detect(IMAGE)
        elf.detect_batch([IMAGE, IMAGE])
        assert elf.saliency(IMAGE).shape == IMAGE.shape[:2]
        _check(found, IMAGE.shape)
        if elf.contract.descriptors:
            elf.describe(IMAGE, [(1.0, 2.0)])


def _check(found: Any, shape: tuple[int, ...]) -> None:
    """Keypoints that lie in the image, scores that descend, descriptors that are finite."""
    assert np.isfinite(found.keypoints).all()
    assert ((found.keypoints >= 0) & (found.keypoints <= (shape[1] - 1, shape[0] - 1))).all()
    assert np.isfinite(found.scores).all()
    assert (np.diff(found.scores) <= 0).all()
    assert np.isfinite(found.descriptors).all()


def foreign_models(seed: int, limit: int) -> Iterator[Job]:
    """Mutants of somebody's networks through ``elf-export --onnx``."""
    from export import small_models as small

    from . import graphs

    models = {"relu2": small.nchw(), "y": small.pyramid()}
    sources = {
        (layer, kind): made
        for i, (layer, model) in enumerate(models.items())
        for kind, made in (
            ("fields", graphs.mutants(model, seed + i)), ("bytes", wire.mutants(model.SerializeToString(), seed + i)),
        )
    }  # fmt: skip
    for number in range(limit):
        layer = list(models)[number % 2]
        what, data = next(sources[layer, "bytes" if number % 5 == 4 else "fields"])
        yield f"network {layer}, {number}: {what}", lambda d=data, n=number, k=layer: _foreign(d, k, n)


def _foreign(data: bytes, layer: str, number: int) -> None:
    from elf_export.cli import main as export

    with tempfile.TemporaryDirectory() as folder:
        path, out = Path(folder, "model.onnx"), Path(folder, "elf.onnx")
        path.write_bytes(data)
        if number % 3 == 0:
            command(export, ["--onnx", str(path), "--list"])
            return
        try:
            command(export, ["--onnx", str(path), "--layer", layer, "--desc", layer, "-o", str(out)])
        finally:
            assert sorted(p.name for p in Path(folder).iterdir()) in (["model.onnx"], ["elf.onnx", "model.onnx"])
        elf = ElfRuntime(out, threads=1)
        for shape in ((66, 71), (98, 130)):
            _check(elf.detect(textured(*shape)), shape)


def picture_files(seed: int, limit: int) -> Iterator[Job]:
    """Mutants of image files through the runtime and elf-detect, and mutants of arrays through the runtime."""
    files, arrays = images.files(seed), images.arrays(seed)
    for number in range(limit):
        if number % 3 == 2:
            what, array = next(arrays)
            yield f"array {number}: {what}", lambda array=array: _array(array)
        else:
            what, ending, data = next(files)
            yield f"image {number}: {what}", lambda data=data, ending=ending, n=number: _picture(data, ending, n)


def _array(array: Any) -> None:
    elf = ElfRuntime(TINY, threads=1, max_pixels=LARGEST)
    found = elf.detect(array)
    _check(found, np.shape(array))
    elf.detect(IMAGE, mask=np.ones(IMAGE.shape[:2], bool))
    try:
        elf.detect(IMAGE, mask=array)
    except ImageError:
        return


def _picture(data: bytes, ending: str, number: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"picture{ending}")
        path.write_bytes(data)
        if number % 2:
            options = ["--model", str(TINY), "--threads", "1", "--max-pixels", str(LARGEST)]
            command(detect, [str(path), "-o", f"{folder}/out", *options])
            return
        elf = ElfRuntime(TINY, threads=1, max_pixels=LARGEST)
        found = elf.detect(path)
        _check(found, found.image_size)
