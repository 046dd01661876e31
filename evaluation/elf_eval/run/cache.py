"""Features on disk, by the content that they were made from."""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_eval.data.images import ImageRef
from elf_eval.features import LocalFeatures
from elf_eval.geometry import Float, Size
from elf_eval.methods import Composed, Method
from elf_eval.protocol import Protocol
from elf_runtime.files.write import write_atomically

_SCHEMA = 1


@dataclass(frozen=True)
class Extracted:
    """Features of an image, and what is needed of the image to evaluate them without it.

    Attributes
    ----------
    features : LocalFeatures
    size : (width, height)
        Of the working image.
    to_working : (3, 3)
        Pixels of the file -> pixels of the working image.
    seconds : float
        Time of the extraction when it was made; the image was decoded before.
    """

    features: LocalFeatures
    size: Size
    to_working: Float
    seconds: float

    def digest(self) -> str:
        """SHA-256 of all but the time."""
        f = self.features
        sha = hashlib.sha256(repr(self.size).encode())
        for array in (f.keypoints, f.scores, f.descriptors, f.sizes, f.angles, self.to_working):
            sha.update(f"{array.dtype}{array.shape}".encode())
            sha.update(np.ascontiguousarray(array).tobytes())
        return sha.hexdigest()


def default_folder() -> Path:
    """``$XDG_CACHE_HOME/elf-eval``, or ``~/.cache/elf-eval``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "elf-eval"


class FeatureCache:
    """One .npz a method and image.

    The name is a hash of the image's bytes, of what is done to it, of the method's fingerprint and of the
    number of keypoints: a changed file, setting, model or version is another name, and nothing ever has to
    be cleared.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, fingerprint: str, ref: ImageRef, protocol: Protocol) -> Path:
        """Where the features of an image are, or will be."""
        parts = [_SCHEMA, fingerprint, ref.digest(protocol.size), protocol.max_keypoints]
        key = hashlib.sha256(json.dumps(parts).encode()).hexdigest()
        return self.folder / key[:2] / f"{key}.npz"

    def get(self, method: Method, ref: ImageRef, protocol: Protocol) -> tuple[Path, Extracted]:
        """The features, from the disk or made and put there, and their file."""
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


def extract(method: Method, ref: ImageRef, protocol: Protocol, detected: Extracted | None = None) -> Extracted:
    """Run `method` on an image, or let it describe what another has `detected` there."""
    image = ref.open(protocol.size)
    size, to_working = image.size, image.to_working  # decodes: that is not the method's time
    start = perf_counter()
    if detected is None:
        features, before = method.extract(image, protocol.max_keypoints), 0.0
    else:
        features, before = method.describe(image, detected.features), detected.seconds
    return Extracted(features, size, to_working, before + perf_counter() - start)


def load(path: Path) -> Extracted | None:
    """None where there is no such file, or one that is damaged."""
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as data:
            return _extracted(data)  # the archive's checksums are compared on the way
    except Exception:  # whatever the reader of an archive stumbles over in a damaged one
        return None


def _extracted(data: Mapping[str, npt.NDArray[Any]]) -> Extracted:
    """What `save` wrote; an exception of some kind where it is not that."""
    keys = ("keypoints", "scores", "descriptors", "sizes", "angles")
    features = LocalFeatures.build(*(data[key] for key in keys))
    width, height = (int(v) for v in data["size"])
    return Extracted(features, (width, height), data["to_working"].reshape(3, 3), float(data["seconds"]))


def save(path: Path, found: Extracted) -> None:
    """Write the features of an image; a file that is there is whole."""
    path.parent.mkdir(parents=True, exist_ok=True)
    f = found.features
    arrays: dict[str, Any] = {
        "keypoints": f.keypoints,
        "scores": f.scores,
        "descriptors": f.descriptors,
        "sizes": f.sizes,
        "angles": f.angles,
        "size": np.asarray(found.size),
        "to_working": found.to_working,
        "seconds": np.float64(found.seconds),
    }
    write_atomically(path, lambda part: np.savez(part, **arrays))
