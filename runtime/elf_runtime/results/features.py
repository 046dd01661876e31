"""`Features`: keypoints, scores and descriptors of an image, and the files they are kept in."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_runtime.errors import ElfError, SettingError
from elf_runtime.files.write import write_atomically
from elf_runtime.image.masks import to_mask
from elf_runtime.indices import rows_at
from elf_runtime.pictures.notebook import features_png
from elf_runtime.values import is_int

from .files.npz import load_record as load_record
from .files.npz import write_npz
from .files.read import read_fields
from .files.table import write_csv
from .opencv import fields_of, keypoints_of
from .quantization import quantized

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
        Rows of unit L2 norm; D = 0 for a model without a descriptor.  uint8 where `quantized` made them so.
    image_size : (height, width)
        Of the source image, in pixels; of a file, turned as its EXIF orientation says (see `image.read`).
    nms_radius : float
        In pixels of the source image.
    sizes : (N,) float32
        Diameter of a keypoint's neighbourhood in pixels of the source image: its suppression window, 2 nms_radius + 1,
        times the finest working scale over its own.  If oriented, times up to 2 or down to 1/2, by what lies under it.
    angles : (N,) float32
        Orientation in degrees from 0 to below 360, clockwise from the x axis in the image, as in OpenCV; -1 is none.
    record : mapping, optional
        Where they come from, as plain data.  `ElfRuntime` gives: image (the path) and image_sha256, if it was given a
        path; model (its path, or "bundled") and model_sha256; network, layer and descriptor; settings, as
        `DetectionParams.to_dict`; elf-onnx, the version.
    """

    keypoints: Array
    scores: Array
    descriptors: npt.NDArray[Any]
    image_size: tuple[int, int]
    nms_radius: float = 10.0
    sizes: Array = None  # type: ignore[assignment]  # an array in any instance: by default all of the finest scale
    angles: Array = None  # type: ignore[assignment]  # by default all -1
    record: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        for name, default in (("sizes", self._finest), ("angles", -1.0)):
            given = getattr(self, name)
            values = np.full(len(self), default, np.float32) if given is None else np.asarray(given, np.float32)
            object.__setattr__(self, name, values)
            if values.shape != (len(self),):
                raise ElfError(f"{name} have shape {values.shape}, not (N,) for {len(self)} keypoints")
        for name in ("keypoints", "scores"):
            if not np.isfinite(getattr(self, name)).all():
                raise ElfError(f"some {name} are NaN or infinite")
        if not ((self.sizes > 0) & np.isfinite(self.sizes)).all():
            raise ElfError("some sizes are not above 0, or not finite")
        if not ((self.angles == -1) | ((self.angles >= 0) & (self.angles < 360))).all():
            raise ElfError("some angles are neither in [0, 360) nor -1")

    @property
    def _finest(self) -> float:
        return window_size(self.nms_radius, self.image_size)

    def __len__(self) -> int:
        return len(self.keypoints)

    def __getitem__(self, index: Any) -> Features:
        """The features at `index`: an integer, a slice, a mask or an array of integers, as of a numpy array.

        They are in the order of `index`; one that leaves the descending order of the scores is the caller's to mind.

        Raises
        ------
        IndexError
            On another index, or one that is out of range.
        """
        rows = rows_at(index, len(self))
        columns = ("keypoints", "scores", "descriptors", "sizes", "angles")
        return replace(self, **{name: getattr(self, name)[rows] for name in columns})

    def strongest(self, count: int) -> Features:
        """The `count` features of the highest scores, or all where there are fewer; scores descend.

        Raises
        ------
        SettingError
            If `count` is no integer from 0 on.
        """
        if not is_int(count) or count < 0:
            raise SettingError(f"count is an integer >= 0, not {count!r}")
        return self[np.argsort(-self.scores, kind="stable")[:count]]

    def inside(self, mask: npt.ArrayLike) -> Features:
        """The features where a mask of the image, (H, W) bool or integers, is not zero.

        It is looked up at the pixel that x and y round to; features outside the image are at its edge.

        Raises
        ------
        ImageError
            If the mask is of another shape than `image_size`, or of floats.
        """
        height, width = self.image_size
        allowed = to_mask(mask, (height, width))
        columns, rows = np.clip(np.rint(self.keypoints), 0, (width - 1, height - 1)).astype(np.int64).T
        return self[allowed[rows, columns]]

    def quantized(self) -> Features:
        """The same with descriptors in 8 bits, (N, D) uint8: a quarter of the memory.

        q = round(128 + 192 x), cut to [0, 255]; the way back is (q - 128) / 192, brought to unit length.  Distances of
        the bytes are 192 times those of the floats, up to rounding.  So `match`, `Matches` and `estimate` take such
        features, also beside others, and ``cv2.BFMatcher(cv2.NORM_L2)`` takes the bytes.

        Raises
        ------
        SettingError
            If descriptors are not of unit length, as SIFT's.
        """
        if self.descriptors.dtype == np.uint8:
            return self
        return replace(self, descriptors=quantized(self.descriptors))

    def to_cv2(self) -> tuple[list[Any], npt.NDArray[Any]]:
        """``(list of cv2.KeyPoint, descriptors)``, as OpenCV's ``detectAndCompute`` returns them.

        A keypoint has its ``size`` and ``angle``, the score as ``response``, and as ``octave`` how many times its
        working scale is half of the finest, rounded.
        """
        return keypoints_of(self, self._finest), self.descriptors

    @classmethod
    def from_cv2(
        cls,
        keypoints: Sequence[Any],
        descriptors: npt.ArrayLike | None,
        image_size: tuple[int, int],
        quantized: bool = False,
    ) -> Features:
        """What one of OpenCV's detectors found, SIFT's say, for `match`, `Matches`, `estimate` and the files.

        Parameters
        ----------
        keypoints : sequence of cv2.KeyPoint
            In any order: they are sorted by ``response``, the highest first.  A size of 0 is that of a single pixel.
        descriptors : (N, D) floats, or None
            Rows of any length; `match` goes by their distances.  None is none: (N, 0).
        image_size : (height, width)
        quantized : bool
            Whether descriptors are the bytes that `quantized`, or ``ElfFeature2D(descriptor_type="uint8")``, made.

        Raises
        ------
        ElfError
            If there are not as many descriptors as keypoints, or they are bits (ORB's).
        """
        return cls(**fields_of(keypoints, descriptors, quantized), image_size=image_size, nms_radius=0.0)

    def __repr__(self) -> str:
        height, width = self.image_size
        return f"Features({len(self)} keypoints, descriptors of {self.descriptors.shape[1]}, image {width}x{height})"

    def _repr_png_(self) -> bytes:
        """In notebooks: the keypoints on their image if `record` names its file, else on a blank canvas."""
        return features_png(self)

    def save(self, path: str | os.PathLike[str], record: Mapping[str, Any] | None = None) -> None:
        """Write a ``.npz`` of the attributes, or a ``.csv`` (x,y,score,size,angle).

        Parameters
        ----------
        path : path
            Its ending says which.  `elf_runtime.results.hloc` and `colmap` write these programs' files.
        record : mapping, optional
            In place of `self.record`.  An ``.npz`` holds it as JSON, and `load_record` reads it alone.

        Raises
        ------
        ElfError
            On another ending, or a record that is not plain data.
        OSError
            If the file can't be written; what was there stays.
        """
        path = Path(path)
        write = {".npz": write_npz, ".csv": write_csv}.get(path.suffix)
        if write is None:
            raise ElfError(f"{path}: features are saved as .npz or .csv, and by elf_runtime.results.hloc as .h5")
        fields = {**vars(self), "record": self.record if record is None else record}
        write_atomically(path, lambda part: write(part, fields))

    @classmethod
    def load(cls, path: str | os.PathLike[str], image_size: tuple[int, int] | None = None) -> Features:
        """Read a ``.npz`` or a ``.csv`` that `save` wrote.

        Parameters
        ----------
        path : path
        image_size : (height, width), optional
            A ``.csv`` does not have it, and needs it here.  Such features have no descriptors.

        Returns
        -------
        Features
            What the file leaves out, nms_radius, sizes, angles or record, has its default; of a ``.csv``, nms_radius is
            that of the smallest size.

        Raises
        ------
        ElfError
            If the file is missing, is not such a file, or its values do not fit together; if `image_size` is missing
            where it is needed, or is another than the file's.
        """
        fields = read_fields(path, image_size)
        try:
            return cls(**fields)
        except ElfError as error:
            raise ElfError(f"{path}: {error}") from error


def window_size(nms_radius: float, image_size: tuple[int, int]) -> float:
    """Side of the suppression window in source pixels, which is the size of a keypoint of the finest working scale."""
    return float(2 * min(nms_radius, max(image_size)) + 1)
