"""Features on disk, under the digest of all that they were made from."""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_eval.data.images import ImageRef
from elf_eval.features import ImageFeatures, LocalFeatures
from elf_eval.methods import Composed, Method
from elf_eval.protocol import Protocol
from elf_runtime.files.write import write_atomically

_SCHEMA = 1


def default_folder() -> Path:
    """``$XDG_CACHE_HOME/elf-eval``, or ``~/.cache/elf-eval``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "elf-eval"


class FeatureCache:
    """One .npz for each method and image.

    Its name is a digest of the image's bytes, of what is done to them, of the method's fingerprint and of the number of
    keypoints.  So a changed file, setting, model or version has another name, and nothing ever needs to be cleared.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, fingerprint: str, ref: ImageRef, protocol: Protocol) -> Path:
        """Where the features of an image are, or will be."""
        parts = [_SCHEMA, fingerprint, ref.digest(protocol.size), protocol.max_keypoints]
        key = hashlib.sha256(json.dumps(parts).encode()).hexdigest()
        return self.folder / key[:2] / f"{key}.npz"

    def get(self, method: Method, ref: ImageRef, protocol: Protocol) -> tuple[Path, ImageFeatures]:
        """The features, read from the disk or made and put there, and their file."""
        path = self.path(method.fingerprint, ref, protocol)
        found = load(path) if method.cacheable else None
        if found is None:
            if method.cacheable and path.exists():
                print(f"elf-eval: {path}: a damaged file of the cache; made again", file=sys.stderr)
            # A detector is run once for all the descriptors that it is combined with.
            detected = self.get(method.detector, ref, protocol)[1] if isinstance(method, Composed) else None
            found = extract(method, ref, protocol, detected)
            save(path, found)
        return path, found


def extract(method: Method, ref: ImageRef, protocol: Protocol, detected: ImageFeatures | None = None) -> ImageFeatures:
    """Run `method` on an image, or let it describe what another one has `detected` there."""
    image = ref.open(protocol.size)
    size, to_working = image.size, image.to_working  # decodes now, because that is not the method's time
    start = perf_counter()
    if detected is None:
        features, before = method.extract(image, protocol.max_keypoints), 0.0
    else:
        features, before = method.describe(image, detected.features), detected.seconds
    return ImageFeatures(features, size, to_working, before + perf_counter() - start)


def load(path: Path) -> ImageFeatures | None:
    """The features of a file; None where there is none, or a damaged one."""
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as data:
            return _image_features(data)  # reading compares the archive's checksums
    except Exception:  # numpy and zipfile raise many kinds on damaged archives
        return None


def _image_features(data: Mapping[str, npt.NDArray[Any]]) -> ImageFeatures:
    """What `save` wrote; an exception of some kind where it is anything else."""
    features = LocalFeatures.build(*(data[field.name] for field in fields(LocalFeatures)))
    width, height = (int(v) for v in data["size"])
    return ImageFeatures(features, (width, height), data["to_working"].reshape(3, 3), float(data["seconds"]))


def save(path: Path, found: ImageFeatures) -> None:
    """Write the features of an image to a file that is whole once it is there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = {"size": found.size, "to_working": found.to_working, "seconds": found.seconds}
    arrays: dict[str, Any] = {**vars(found.features), **image}
    write_atomically(path, lambda part: np.savez(part, **arrays))
