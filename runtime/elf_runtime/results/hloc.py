"""Features and matches in the HDF5 files of hloc, https://github.com/cvg/Hierarchical-Localization.  Needs h5py.

The layout, after hloc's documentation and source: features.h5 has a group for each image, of keypoints (N, 2), where
integers are pixel centres as here, scores (N,), descriptors (D, N) and image_size (width, height); sizes and angles
are ELF's own additions.  matches.h5 has a group ``a/b`` for each pair, whose names have ``-`` for ``/``, of matches0
(N of a,), the partner in b or -1, and matching_scores0.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_runtime.errors import ElfError, SettingError, first_line, reason
from elf_runtime.files.kind import open_regular
from elf_runtime.files.write import write_atomically
from elf_runtime.indices import pairs_of

from .features import Features
from .files.table import radius_of
from .matches import Matches
from .quantization import restored

# What h5py and numpy raise on arrays that are damaged or of other kinds.
_DAMAGED = (ElfError, KeyError, OSError, TypeError, ValueError)


def write_features(
    path: str | os.PathLike[str], features: Mapping[str, Features], uncertainty: float | None = None
) -> None:
    """Write a features.h5.

    Parameters
    ----------
    path : path
    features : mapping
        Name of an image, relative to hloc's folder of images -> its features.  Descriptors are written as float32.
    uncertainty : float, optional
        How exact keypoints are, in pixels: hloc's geometric verification multiplies its threshold by it.  None is
        left out, which hloc takes for 1.

    Raises
    ------
    ElfError
        If h5py is not installed, or a name is no name for a group: empty, or another's folder.
    OSError
        If the file can't be written; what was there stays.
    """

    def write(part: Path) -> None:
        with _h5py().File(part, "w") as file:
            for name, found in features.items():
                group = _new_group(file, name)
                group["keypoints"], group["scores"] = found.keypoints, found.scores
                rows = found.descriptors
                group["descriptors"] = (restored(rows) if rows.dtype == np.uint8 else rows).T
                group["image_size"] = np.array(found.image_size[::-1])
                group["sizes"], group["angles"] = found.sizes, found.angles
                if uncertainty is not None:
                    group["keypoints"].attrs["uncertainty"] = uncertainty

    _h5py()
    write_atomically(Path(path), write)


def read_features(path: str | os.PathLike[str]) -> dict[str, Features]:
    """Read a features.h5, of ELF or of another extractor.

    Returns
    -------
    dict
        Name -> features, in the order of the file and of its scores, which need not descend.  What is missing is 1
        (scores), (N, 0) (descriptors), or the default of `Features`.

    Raises
    ------
    ElfError
        If h5py is not installed; if the file is missing, is none of HDF5, or its arrays do not fit together.
    """
    found: dict[str, Features] = {}
    with _opened(path) as file:
        for name, group in _groups(file, "keypoints"):
            try:
                found[name] = _features(group)
            except _DAMAGED as error:
                raise ElfError(f"{path}: {name}: {first_line(error)}") from error
    return found


def write_matches(
    path: str | os.PathLike[str],
    matches: Mapping[tuple[str, str], tuple[Any, int]] | Iterable[tuple[tuple[str, str], tuple[Any, int]]],
) -> None:
    """Write a matches.h5.

    Parameters
    ----------
    path : path
    matches : mapping, or iterable of its items
        (name a, name b) -> (`Matches` or (K, 2) integers as of `match`, how many features a has).  Scores are the
        similarities of `Matches`, and 1 without.  Of an iterable only one pair of images is in memory at a time.

    Raises
    ------
    ElfError
        If h5py is not installed; if two pairs have one name, as hloc writes / as -; SettingError if matches are no
        indices, those of a not below its count, or not one to one.
    OSError
        If the file can't be written; what was there stays.
    """
    items = matches.items() if isinstance(matches, Mapping) else matches

    def write(part: Path) -> None:
        with _h5py().File(part, "w") as file:
            for names, (given, count) in items:
                key = "/".join(name.replace("/", "-") for name in names)
                if key in file:
                    raise ElfError(f"{key}: hloc writes / as -, which gives two pairs this name")
                group = _new_group(file, key)
                group["matches0"], group["matching_scores0"] = _partners(given, count, key)

    _h5py()
    write_atomically(Path(path), write)


def read_matches(path: str | os.PathLike[str]) -> dict[tuple[str, str], tuple[Matches, int]]:
    """Read a matches.h5, of ELF or of another matcher.

    Returns
    -------
    dict
        (name a, name b), as the file has them, with - for / -> (matches, how many features a has).  Similarities are
        the file's scores, 1 without, and the best is first; ratios, which it does not have, are 1.

    Raises
    ------
    ElfError
        As `read_features`.
    """
    found: dict[tuple[str, str], tuple[Matches, int]] = {}
    with _opened(path) as file:
        for name, group in _groups(file, "matches0"):
            first, _, second = name.partition("/")
            try:
                found[first, second] = _matches(group)
            except _DAMAGED as error:
                raise ElfError(f"{path}: {name}: {first_line(error)}") from error
    return found


def _features(group: Any) -> Features:
    """One image's."""
    points = np.asarray(group["keypoints"], np.float32)
    if points.ndim != 2 or points.shape[1] != 2:
        raise ElfError(f"keypoints have shape {points.shape}, not (N, 2)")
    count = len(points)
    width, height = (int(side) for side in np.asarray(group["image_size"]))
    given = {name: np.asarray(group[name], np.float32) for name in ("scores", "sizes", "angles") if name in group}
    scores = given.pop("scores", np.ones(count, np.float32))
    rows = (
        np.asarray(group["descriptors"], np.float32).T if "descriptors" in group else np.zeros((count, 0), np.float32)
    )
    if scores.shape != (count,) or rows.ndim != 2 or len(rows) != count:
        raise ElfError(f"scores and descriptors have shapes {scores.shape} and {rows.T.shape}, not (N,) and (D, N)")
    fields: dict[str, Any] = dict(given)
    if "sizes" in given:
        fields["nms_radius"] = radius_of(given["sizes"])
    return Features(points, scores, np.ascontiguousarray(rows), (height, width), **fields)


def _matches(group: Any) -> tuple[Matches, int]:
    """One pair's, and how many features its first image has."""
    partners = np.asarray(group["matches0"])
    scores = np.asarray(group["matching_scores0"] if "matching_scores0" in group else np.ones(len(partners)))
    if partners.ndim != 1 or partners.dtype.kind not in "iu" or scores.shape != partners.shape:
        raise ElfError(f"matches0 is {partners.shape} {partners.dtype}, matching_scores0 {scores.shape}")
    index = np.flatnonzero(partners >= 0)
    index = index[np.argsort(-scores[index], kind="stable")]
    pairs = np.stack([index, partners[index]], axis=1).astype(np.int64)
    return Matches(pairs, scores[index].astype(np.float32), np.ones(len(index), np.float32)), len(partners)


def _partners(given: Any, count: int, key: str) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float32]]:
    """Of each feature of a, its partner in b or -1, and the score of that or 0."""
    pairs = pairs_of(given)
    if len(np.unique(pairs[:, 0])) != len(pairs) or (len(pairs) and pairs[:, 0].max() >= count):
        raise SettingError(f"{key}: matches are not of {count} features of the first image, each at most once")
    partners, scores = np.full(count, -1, np.int32), np.zeros(count, np.float32)
    partners[pairs[:, 0]] = pairs[:, 1]
    scores[pairs[:, 0]] = getattr(given, "similarity", 1.0)
    return partners, scores


def _new_group(file: Any, name: str) -> Any:
    try:
        return file.create_group(name)
    except (ValueError, TypeError) as error:
        raise ElfError(f"{name!r} is no name for a group of HDF5: {first_line(error)}") from error


def _groups(file: Any, dataset: str) -> Iterator[tuple[str, Any]]:
    """The names and groups that hold such a dataset, at any depth."""
    names: list[str] = []
    file.visit(lambda name: names.append(name.rpartition("/")[0]) if name.rpartition("/")[2] == dataset else None)
    for name in names:
        yield name, file[name]


@contextmanager
def _opened(path: str | os.PathLike[str]) -> Iterator[Any]:
    library = _h5py()
    try:
        open_regular(path).close()
        file = library.File(path, "r")
    except OSError as error:
        raise ElfError(f"{path}: not an HDF5 file: {reason(error)}") from error
    with file:
        yield file


def _h5py() -> Any:
    try:
        import h5py
    except ImportError:
        raise ElfError("hloc's files need h5py, which is not installed: pip install 'elf-onnx[h5]', or h5py") from None
    return h5py
