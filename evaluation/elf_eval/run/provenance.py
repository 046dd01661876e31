"""What the figures of a run depend on, for its results: methods, data and versions."""

from __future__ import annotations

import hashlib
import json
import platform
import sys
from collections.abc import Collection
from datetime import datetime, timezone
from typing import Any

import cv2
import numpy as np
import onnxruntime

import elf_runtime
from elf_eval.coordinates import Size
from elf_eval.data import Dataset
from elf_eval.protocol import Protocol
from elf_eval.suite.suite import DatasetEntry, MethodEntry


def about_method(
    entry: MethodEntry, fingerprint: str, protocol: Protocol, seconds: Collection[float]
) -> dict[str, Any]:
    """A method's line of the results; `protocol` is the method's own, `seconds` are those of each image."""
    return {
        "name": entry.name,
        "detector": entry.detector,
        "descriptor": entry.descriptor,
        "paper": entry.paper,
        "fingerprint": hashlib.sha256(fingerprint.encode()).hexdigest(),
        "ratio": protocol.ratio,
        "refine": protocol.refine,
        "seconds_per_image": round(sum(seconds) / len(seconds), 4),
    }


def about_dataset(entry: DatasetEntry, dataset: Dataset, size: Size | None) -> dict[str, Any]:
    """A dataset's line of the results."""
    refs = list(dataset.images())
    sha = hashlib.sha256()
    for ref in refs:
        sha.update(ref.digest(size).encode())
    for pair in dataset.pairs:
        sha.update(json.dumps([pair.name, pair.truth.identity()]).encode())
    return {
        "name": entry.name,
        "spec": entry.spec,
        "parameter": dataset.parameter,
        "pairs": len(dataset.pairs),
        "scenes": len(dataset.scenes()),
        "images": len(refs),
        "sha256": sha.hexdigest(),
        "published": entry.published,
        "paper": entry.paper,
    }


def versions() -> dict[str, str]:
    """Of all that the figures depend on."""
    return {
        "elf-onnx": elf_runtime.__version__,
        "python": sys.version.split()[0],
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "onnxruntime": onnxruntime.__version__,
        "system": f"{platform.system()} {platform.machine()}",
    }


def now() -> str:
    """ISO 8601, UTC, to the second."""
    return datetime.now(timezone.utc).isoformat(timespec="seconds")
