"""Features as OpenCV has them: `cv2.KeyPoint` and an array of descriptors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.errors import ElfError

if TYPE_CHECKING:
    from .features import Features


def keypoints_of(features: Features, finest: float) -> list[Any]:
    """The features as cv2.KeyPoint; `finest` is the size of those of the finest working scale, in pixels."""
    octaves = np.rint(np.log2(features.sizes / finest)).astype(np.int64)
    columns = (features.keypoints, features.sizes, features.angles, features.scores, octaves)
    return [
        cv2.KeyPoint(x, y, size, angle, score, octave)
        for (x, y), size, angle, score, octave in zip(*(column.tolist() for column in columns), strict=True)
    ]


def fields_of(keypoints: Sequence[Any], descriptors: npt.ArrayLike | None, quantized: bool = False) -> dict[str, Any]:
    """The fields of `Features` that cv2.KeyPoint and descriptors give, by name: see `Features.from_cv2`."""
    rows = np.zeros((len(keypoints), 0), np.float32) if descriptors is None else np.asarray(descriptors)
    is_kind = rows.dtype == np.uint8 if quantized and descriptors is not None else rows.dtype.kind == "f"
    if rows.ndim != 2 or len(rows) != len(keypoints) or not is_kind:
        kind = "uint8" if quantized else "floats"
        hint = "; of bytes that quantized() made, say quantized=True" if rows.dtype == np.uint8 else ""
        raise ElfError(
            f"descriptors of {len(keypoints)} keypoints are (N, D) {kind}, not {rows.shape} {rows.dtype}{hint}"
        )
    table = [(*point.pt, point.response, point.size, point.angle) for point in keypoints]
    x, y, scores, sizes, angles = np.array(table, np.float32).reshape(-1, 5).T
    order = np.argsort(-scores, kind="stable")
    turned = np.where(angles < 0, np.float32(-1), np.mod(angles, np.float32(360)))
    return {
        "keypoints": np.stack([x, y], axis=1)[order],
        "scores": scores[order],
        "descriptors": rows[order] if rows.dtype == np.uint8 else rows.astype(np.float32)[order],
        "sizes": np.where(sizes > 0, sizes, np.float32(1))[order],
        "angles": turned[order],
    }
