"""Descriptors in 8 bits: a quarter of float32's memory, compared by the same distance.

    q = round(128 + 192 x), cut to [0, 255];   x = (q - 128) / 192, brought to unit length

One map for all values of all rows, so that |q_a - q_b| is 192 |x_a - x_b| up to rounding: what compares bytes by their
L2 distance, such as ``cv2.BFMatcher(cv2.NORM_L2)``, takes them as they are.  What is beyond [-0.667, 0.661] is cut off,
which is rare in rows of unit length.  Of 127, 192, 256, 320, 384 and 512, 192 left the most matches as they were over
five models and settings (64 to 512 values, with and without whitening) on the exporter's calibration photographs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from elf_runtime.errors import SettingError

SCALE, ZERO = 192, 128
_TOLERANCE = 1e-3  # of a row's length


def quantized(rows: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """Rows of unit L2 norm, (N, D) floats, as bytes; a row of zeros is one of `ZERO`.

    Raises
    ------
    SettingError
        If a row has another length.
    """
    lengths = np.sqrt(np.einsum("nd,nd->n", rows, rows, dtype=np.float64))
    if rows.shape[1] and not ((np.abs(lengths - 1) < _TOLERANCE) | (lengths == 0)).all():
        raise SettingError("8 bits are for descriptors of unit length, as ELF's; these have others")
    return np.asarray(np.clip(np.rint(ZERO + SCALE * rows), 0, 255), np.uint8)


def restored(rows: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
    """What `quantized` made bytes of, up to their rounding: (N, D), rows of unit L2 norm (zeros stay zeros)."""
    values = (rows.astype(np.float32) - ZERO) / SCALE
    lengths = np.sqrt(np.einsum("nd,nd->n", values, values, dtype=np.float64))
    return (values / np.where(lengths > 0, lengths, 1)[:, None]).astype(np.float32)
