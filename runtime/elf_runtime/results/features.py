"""`Features`: keypoints, scores and descriptors of an image, and the files they are kept in."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.errors import ElfError, reason
from elf_runtime.files.kind import open_regular
from elf_runtime.files.write import write_atomically

Array = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Features:
    """Keypoints of one image with scores and descriptors.  Instances compare by identity.

    Attributes
    ----------
    keypoints : (N, 2) float32
        (x, y) in pixels of the source image; integer = pixel centre, as in OpenCV.
    scores : (N,) float32
        Descending; ties in raster order, those of a finer scale first.  The denoised saliency, on a scale where 255 is
        the quantile of it that `DetectionParams.normalize` names (its maximum with the paper's settings).
    descriptors : (N, D) float32
        Rows of unit L2 norm; D = 0 for a model without a descriptor.
    image_size : (height, width)
        Of the source image, in pixels; of a file, turned as its EXIF orientation says (see `image.read`).
    nms_radius : float
        In pixels of the source image.
    sizes : (N,) float32
        Diameter of a keypoint's neighbourhood in pixels of the source image: its suppression window, 2 nms_radius + 1,
        times the finest working scale over its own.
    angles : (N,) float32
        Orientation in degrees from 0 to below 360, clockwise from the x axis in the image, as in OpenCV; -1 is none.
    """

    keypoints: Array
    scores: Array
    descriptors: Array
    image_size: tuple[int, int]
    nms_radius: float = 10.0
    sizes: Array = None  # type: ignore[assignment]  # an array in any instance: by default all of the finest scale
    angles: Array = None  # type: ignore[assignment]  # by default all -1

    def __post_init__(self) -> None:
        for name, default in (("sizes", self._finest), ("angles", -1.0)):
            given = getattr(self, name)
            values = np.full(len(self), default, np.float32) if given is None else np.asarray(given, np.float32)
            object.__setattr__(self, name, values)
            if values.shape != (len(self),):
                raise ElfError(f"{name} have shape {values.shape}, not (N,) for {len(self)} keypoints")
        if not ((self.sizes > 0) & np.isfinite(self.sizes)).all():
            raise ElfError("some sizes are not above 0, or not finite")
        if not ((self.angles == -1) | ((self.angles >= 0) & (self.angles < 360))).all():
            raise ElfError("some angles are neither in [0, 360) nor -1")

    @property
    def _finest(self) -> float:
        return window_size(self.nms_radius, self.image_size)

    def __len__(self) -> int:
        return len(self.keypoints)

    def to_cv2(self) -> tuple[list[Any], Array]:
        """``(list of cv2.KeyPoint, descriptors)``, as OpenCV's ``detectAndCompute`` returns them.

        A keypoint has its ``size`` and ``angle``, the score as ``response``, and as ``octave`` how many times its
        working scale is half of the finest, rounded.
        """
        octaves = np.rint(np.log2(self.sizes / self._finest)).astype(np.int64)
        columns = (self.keypoints, self.sizes, self.angles, self.scores, octaves)
        points = [
            cv2.KeyPoint(x, y, size, angle, score, octave)
            for (x, y), size, angle, score, octave in zip(*(column.tolist() for column in columns), strict=True)
        ]
        return points, self.descriptors

    @classmethod
    def from_cv2(
        cls, keypoints: Sequence[Any], descriptors: npt.ArrayLike | None, image_size: tuple[int, int]
    ) -> Features:
        """What one of OpenCV's detectors found, SIFT's say, for `match`, `Matches`, `estimate` and the files.

        Parameters
        ----------
        keypoints : sequence of cv2.KeyPoint
            In any order: they are sorted by ``response``, the highest first.  A size of 0 is that of a single pixel.
        descriptors : (N, D) floats, or None
            Rows of any length; `match` goes by their distances.  None is none: (N, 0).
        image_size : (height, width)

        Raises
        ------
        ElfError
            If there are not as many descriptors as keypoints, or they are bits (ORB's).
        """
        rows = np.zeros((len(keypoints), 0), np.float32) if descriptors is None else np.asarray(descriptors)
        if rows.ndim != 2 or len(rows) != len(keypoints) or rows.dtype.kind != "f":
            raise ElfError(
                f"descriptors of {len(keypoints)} keypoints are (N, D) floats, not {rows.shape} {rows.dtype}"
            )
        table = [(*point.pt, point.response, point.size, point.angle) for point in keypoints]
        x, y, scores, sizes, angles = np.array(table, np.float32).reshape(-1, 5).T
        order = np.argsort(-scores, kind="stable")
        turned = np.where(angles < 0, np.float32(-1), np.mod(angles, np.float32(360)))
        return cls(
            np.stack([x, y], axis=1)[order], scores[order], rows.astype(np.float32)[order], image_size, nms_radius=0.0,
            sizes=np.where(sizes > 0, sizes, np.float32(1))[order], angles=turned[order],
        )  # fmt: skip

    def __repr__(self) -> str:
        height, width = self.image_size
        return f"Features({len(self)} keypoints, descriptors of {self.descriptors.shape[1]}, image {width}x{height})"

    def save(self, path: str | os.PathLike[str], record: Mapping[str, Any] | None = None) -> None:
        """Write a ``.npz`` of the attributes, or a ``.csv`` (x,y,score,size,angle).

        Parameters
        ----------
        path : path
        record : mapping, optional
            Where they come from, as plain data.  An ``.npz`` holds it as JSON, and `load_record` reads it.

        Raises
        ------
        ElfError
            On another ending.
        OSError
            If the file can't be written; what was there stays.
        """
        path = Path(path)
        writers = {".npz": lambda part: self._write_npz(part, record), ".csv": self._write_csv}
        if path.suffix not in writers:
            raise ElfError(f"{path}: features are saved as .npz or .csv")
        write_atomically(path, writers[path.suffix])

    def _write_npz(self, path: Path, record: Mapping[str, Any] | None) -> None:
        extra: dict[str, Any] = {} if record is None else {"record": json.dumps(record, sort_keys=True)}
        np.savez_compressed(
            path,
            keypoints=self.keypoints,
            scores=self.scores,
            descriptors=self.descriptors,
            image_size=np.asarray(self.image_size),
            nms_radius=np.float64(self.nms_radius),
            sizes=self.sizes,
            angles=self.angles,
            **extra,
        )

    def _write_csv(self, path: Path) -> None:
        table = np.column_stack([self.keypoints, self.scores, self.sizes, self.angles])
        np.savetxt(path, table, delimiter=",", header="x,y,score,size,angle", comments="", fmt="%.3f")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Features:
        """Read a ``.npz`` that `save` wrote.  One without nms_radius, sizes or angles has the defaults.

        Raises
        ------
        ElfError
            If the file is missing, is not such a file, or its arrays do not fit together.
        """
        try:
            with open_regular(path) as file:  # numpy would leave it open where it is damaged
                if not zipfile.is_zipfile(file):
                    raise TypeError("it is no .npz archive")
                file.seek(0)
                data = np.load(file, allow_pickle=False)
                height, width = (int(side) for side in data["image_size"])
                radius = float(data["nms_radius"]) if "nms_radius" in data else cls.nms_radius
                points, scores, rows = (_floats(data, name) for name in ("keypoints", "scores", "descriptors"))
                more = {name: _floats(data, name) for name in ("sizes", "angles") if name in data}
        except Exception as error:  # what numpy, zipfile and zlib raise on a damaged file has no common base
            raise ElfError(f"{path}: not a feature file: {reason(error)}") from error
        shapes = (points.shape, scores.shape, rows.shape)
        if rows.ndim != 2 or points.shape != (len(rows), 2) or scores.shape != (len(rows),):
            raise ElfError(f"{path}: keypoints, scores and descriptors have shapes {shapes}, not (N, 2), (N,), (N, D)")
        if min(height, width) < 1 or not radius >= 0:
            raise ElfError(f"{path}: image_size is {height, width} and nms_radius {radius:g}")
        try:
            return cls(points, scores, rows, (height, width), radius, **more)
        except ElfError as error:
            raise ElfError(f"{path}: {error}") from error


def window_size(nms_radius: float, image_size: tuple[int, int]) -> float:
    """Side of the suppression window in source pixels, which is the size of a keypoint of the finest working scale."""
    return float(2 * min(nms_radius, max(image_size)) + 1)


def load_record(path: str | os.PathLike[str]) -> dict[str, Any] | None:
    """The record that `Features.save` put into a ``.npz``; None where there is no such file or record."""
    try:
        with open_regular(path) as file, np.load(file, allow_pickle=False) as data:
            record = json.loads(str(data["record"]))
    except Exception:  # what numpy, zipfile and zlib raise on another file has no common base
        return None
    return record if isinstance(record, dict) else None


def _floats(data: Mapping[str, npt.NDArray[Any]], name: str) -> Array:
    array = data[name]
    if array.dtype.kind != "f":
        raise TypeError(f"{name} is of {array.dtype}, not float32")
    return array.astype(np.float32, copy=False)
