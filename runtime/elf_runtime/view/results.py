"""What the page shows of a result of elf-detect: sought again in its image, if that and the model are at hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from elf_runtime.engine import ElfRuntime
from elf_runtime.errors import ElfError, SettingError
from elf_runtime.params import DetectionParams
from elf_runtime.pictures.source import recorded_image
from elf_runtime.results.features import Features

from .shown import Shown, detected, small

_FIXED = "only level and count can be changed, and only to fewer keypoints"


def of_result(elf: ElfRuntime, path: Path, name: str) -> Shown:
    """The image of an ``.npz``, with the map if it can be had; else with the keypoints of the file, and a note why.

    Raises
    ------
    ElfError
        If the file is no feature file, or its record has settings that this version does not know.
    """
    features = Features.load(path)
    record = features.record or {}
    pixels = recorded_image(features)
    if pixels is None:
        return Shown(name, None, _quantized(features), None, f"its image is not at hand, or another by now: {_FIXED}")
    if record.get("model_sha256") != elf.sha256:
        why = f"detected by another model, which --model FILE gives: {_FIXED}"
    elif "mask_sha256" in record:
        why = f"detected with a mask, which is not at hand: {_FIXED}"
    else:
        try:
            params = DetectionParams.from_dict(record["settings"])
            return detected(elf, name, pixels, params, record.get("descriptor"))
        except (KeyError, TypeError, SettingError) as error:
            raise ElfError(f"{path}: its record can't be followed: {error}") from error
    return Shown(name, small(pixels), _quantized(features), None, why)


def _quantized(features: Features) -> Features:
    """In uint8; without descriptors where these are not of unit length, as SIFT's."""
    features = features.strongest(len(features))
    try:
        return features.quantized()
    except SettingError:
        return replace(features, descriptors=np.zeros((len(features), 0), np.uint8))
