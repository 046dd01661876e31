"""Where features come from: their `record`, plain data that JSON holds as it is."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy.typing as npt

from elf_runtime.contract import DescriptorSpec
from elf_runtime.image.file import ImageFile, ImageLike, read
from elf_runtime.model.network import Network
from elf_runtime.params import DetectionParams
from elf_runtime.version import __version__


@dataclass(frozen=True)
class Prepared:
    """An image as `Maps` or `Alone` made it ready, and which file it is; of an array nothing is known."""

    image: Any
    source: Mapping[str, str]


def read_with_source(
    image: ImageLike, max_pixels: int | None, color: str
) -> tuple[npt.NDArray[Any], Mapping[str, str]]:
    """What `image.read` gives, and of a file its path, links resolved, with the SHA-256 of its bytes."""
    if not isinstance(image, (str, os.PathLike)):
        return read(image, max_pixels=max_pixels, color=color), {}
    file = ImageFile(image, max_pixels)
    pixels = file.decoded()
    return pixels, {"image": os.path.realpath(file.path), "image_sha256": file.sha256}


def record_of(
    network: Network, params: DetectionParams, spec: DescriptorSpec | None, source: Mapping[str, str]
) -> dict[str, Any]:
    """`Features.record` of an image by this model and these settings."""
    return {
        **source,
        "model": "bundled" if network.given[0] is None else network.name,
        "model_sha256": network.sessions.sha256,
        "network": network.contract.network,
        "layer": network.contract.layer,
        "descriptor": spec.layer if spec else None,
        "settings": {name: list(v) if isinstance(v, tuple) else v for name, v in params.to_dict().items()},
        "elf-onnx": __version__,
    }
