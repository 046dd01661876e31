"""Features that another program wrote, so that the program can be compared without its code.

``npz:FOLDER``  one file an image, D2-Net's style: keypoints (N, 2 or more: x, y, ...), scores (N,) and
                descriptors (N, D), at FOLDER/<image name><suffix>
``h5:FILE``     one group an image, hloc's style: keypoints (N, 2), scores (N,), descriptors (D, N)

The image's name is the dataset's, e.g. ``v_graf/1.ppm``, or that which ``elf-eval images`` writes it under,
``v_graf/1.png``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from elf_eval.coordinates import warp
from elf_eval.data.images import Image, ImageRef, written_name
from elf_eval.errors import EvalError, reason
from elf_eval.features import LocalFeatures
from elf_eval.spec import Spec
from elf_runtime.results.quantization import restored

from .method import Method


class Precomputed(Method):
    """``npz:FOLDER`` or ``h5:FILE``.

    Options: ``frame=source`` (keypoints in pixels of the file, the default) or ``frame=working`` (in pixels of the
    resized image), and for npz ``suffix=.npz``.  A file without scores lists its strongest keypoints first; sizes and
    angles are read under these names, as `elf_runtime.Features` saves them, and its descriptors in 8 bits as floats.
    """

    cacheable = False

    def __init__(self, spec: Spec, threads: int | None) -> None:
        del threads
        self._frame = spec.take("frame", str, "source")
        if self._frame not in ("source", "working"):
            raise EvalError(f"{spec.text}: option frame={self._frame}: expected source or working")
        self._is_h5 = spec.kind == "h5"
        self._path = spec.file("features") if self._is_h5 else spec.folder()
        self._suffix = "" if self._is_h5 else spec.take("suffix", str, ".npz")
        self.fingerprint = f"{spec.kind} {self._path.resolve()} {self._suffix} {self._frame}"

    def check(self, refs: Sequence[ImageRef]) -> None:
        names = [ref.name for ref in refs]
        there = self._groups(names) if self._is_h5 else {name for name in names if self._file(name).is_file()}
        missing = [name for name in names if name not in there]
        if missing:
            name = missing[0]
            where = f"{self._path}:{name}" if self._is_h5 else self._file(name)
            more = f", nor of {len(missing) - 1} others of {len(refs)} images" if len(missing) > 1 else ""
            raise EvalError(f"{where}: no features of {name}{more}")

    def extract(self, image: Image, limit: int) -> LocalFeatures:
        where, data = self._read_h5(image) if self._is_h5 else self._read_npz(image)
        if "keypoints" not in data:
            raise EvalError(f"{where}: no keypoints in it; there are {sorted(data)}")
        points = np.asarray(data["keypoints"], np.float64).reshape(len(data["keypoints"]), -1)[:, :2]
        sizes, angles = data.get("sizes", 12.0), data.get("angles", -1.0)
        if self._frame == "source":
            points = warp(image.to_working, points)
            if "sizes" in data:
                sizes = sizes * np.sqrt(abs(np.linalg.det(image.to_working[:2, :2])))
        scores = data.get("scores", -np.arange(len(points), dtype=np.float32))
        descriptors = data.get("descriptors")
        if descriptors is not None and self._is_h5:
            descriptors = descriptors.T
        if descriptors is not None and "quantization" in data:
            descriptors = restored(descriptors)
        try:
            return LocalFeatures.build(points, scores, descriptors, sizes, angles).first(limit)
        except (EvalError, ValueError) as error:
            raise EvalError(f"{where}: {error}") from error

    def _read_npz(self, image: Image) -> tuple[Path, Mapping[str, Any]]:
        path = self._file(image.name)
        try:
            with np.load(path, allow_pickle=False) as file:
                return path, dict(file)
        except (OSError, ValueError) as error:
            raise EvalError(f"{path}: no features of {image.name}: {reason(error)}") from error

    def _file(self, name: str) -> Path:
        """The image's file, by the name that `elf-eval images` gives it where there is none by its own."""
        own, written = (self._path / (each + self._suffix) for each in (name, written_name(name)))
        return written if written.is_file() and not own.is_file() else own

    def _read_h5(self, image: Image) -> tuple[str, Mapping[str, Any]]:
        where = f"{self._path}:{image.name}"
        with self._h5() as file:
            name = next((name for name in (image.name, written_name(image.name)) if name in file), None)
            if name is None:
                raise EvalError(f"{where}: no such group; the file has {list(file)[:5]} ...")
            return where, {key: np.asarray(value) for key, value in file[name].items()}

    def _groups(self, names: Sequence[str]) -> set[str]:
        """Which of these images the file has a group for."""
        with self._h5() as file:
            return {name for name in names if name in file or written_name(name) in file}

    @contextmanager
    def _h5(self) -> Iterator[Any]:
        try:
            import h5py
        except ImportError as error:
            raise EvalError("h5py, which reads .h5 files, is not installed: pip install h5py") from error
        try:
            with h5py.File(self._path, "r") as file:
                yield file
        except OSError as error:
            raise EvalError(f"{self._path}: not an HDF5 file: {reason(error)}") from error
