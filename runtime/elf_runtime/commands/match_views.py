"""The images of elf-match: each detected once or read from its feature file, and kept within a bound of memory."""

from __future__ import annotations

import argparse
import tempfile
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_runtime.errors import ElfError, SettingError
from elf_runtime.image.exif import focal_length_px
from elf_runtime.image.file import ImageFile, image_errors
from elf_runtime.results.features import Features, load_record
from elf_runtime.results.global_descriptor import global_descriptor, nearest, nearest_pairs

from . import options
from .command import UsageError, text_of
from .match_cameras import Float, Intrinsics
from .match_pairs import FEATURE_SUFFIX, Pairs
from .match_records import and_more, check_records, warn

MOST_BYTES = 1 << 30  # of features in memory; more are in a temporary folder
_DETECTING = (
    "max_keypoints", "threshold", "nms_radius", "border", "grid", "preset", "scale", "max_side", "descriptor", "set",
    "mask", "model", "provider", "threads",
)  # fmt: skip


class Views:
    """Images and feature files by their place in `paths`; a context that removes its temporary folder.

    Parameters
    ----------
    paths : sequence of Path
    args : options of model, images and detection

    Raises
    ------
    UsageError
        If options of the detection are given, and nothing is detected.
    ElfError
        If feature files, or one and the model, are of two models.
    """

    def __init__(self, paths: Sequence[Path], args: argparse.Namespace) -> None:
        self.paths, self._args = list(paths), args
        self._records = {i: load_record(p) for i, p in enumerate(self.paths) if p.suffix == FEATURE_SUFFIX}
        self._elf = None if len(self._records) == len(self.paths) else options.open_runtime(args)
        self._mask = options.read_mask(args)
        given = [name for name in _DETECTING if getattr(args, name) not in (None, [])]
        if self._elf is None and given:
            option = given[0].replace("_", "-")
            raise UsageError(f"--{option}: all of these are feature files, so nothing is detected; leave it out")
        if self._elf is not None and self._elf.contract.descriptor(args.descriptor) is None:
            raise SettingError(f"{args.model}: exported with --desc none, it can't describe, and so not match")
        self._origin = self._agreed()
        self._kept: OrderedDict[int, Features] = OrderedDict()
        self._in_memory = 0
        self._put_aside: set[int] = set()
        self._errors: dict[int, str] = {}
        self._about: dict[int, dict[str, Any]] = {}
        self._seen: OrderedDict[int, npt.NDArray[Any]] = OrderedDict()
        self._stack = ExitStack()
        self._folder: Path | None = None

    def __enter__(self) -> Views:
        return self

    def __exit__(self, *error: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._stack.close()

    @property
    def origin(self) -> dict[str, Any]:
        """Model, provider and settings, as `options.origin`; of feature files alone, those of their record."""
        return self._origin

    def about(self, index: int) -> dict[str, Any]:
        """What the JSON says of an image: its path, and what is known of it so far."""
        error = {"error": self._errors[index]} if index in self._errors else {}
        return {"image": str(self.paths[index])} | self._about.get(index, {}) | error

    def has_failed(self, index: int) -> bool:
        return index in self._errors

    def features(self, index: int) -> Features:
        """The features of an image.

        Raises
        ------
        ElfError, OSError
            If they can't be had: the first time with what was wrong, and the same text later.
        """
        if index in self._kept:
            self._kept.move_to_end(index)
            return self._kept[index]
        if index in self._errors:
            raise ElfError(self._errors[index])
        try:
            found = self._found(index)
        except (ElfError, OSError) as error:
            self._errors[index] = text_of(error)
            raise
        self._keep(index, found)
        return found

    @property
    def images(self) -> int:
        """How many are detected in, and not read from feature files."""
        return len(self.paths) - len(self._records)

    def detect_all(self, step: Callable[[], None]) -> None:
        """Detect in every image, before anything is matched or pooled; `step` is called after each.

        One after the other they are quick, in turns they are not: the threads of the network and those of NumPy's
        products spin for a while when they are done, in each other's way where cores are few.
        """
        for index in range(len(self.paths)):
            if index not in self._records:
                with suppress(ElfError, OSError):  # which are kept, for those who ask for its features
                    self.features(index)
                step()

    def _found(self, index: int) -> Features:
        path = self.paths[index]
        if self._folder is not None and index in self._put_aside:
            return Features.load(self._folder / f"{index}.npz")
        if index in self._records:
            found = Features.load(path)
            record = self._records[index] or {}
            about = {"sha256": record.get("image_sha256"), "features_of": record.get("image")}
        else:
            image = ImageFile(path, self._args.max_pixels)
            pixels, about = image.decoded(self._args.ignore_exif), {"sha256": image.sha256}
            with image_errors(path):
                found = self._detect(pixels)
        self._about[index] = about | {"size": list(found.image_size), "keypoints": len(found)}
        return found

    def _detect(self, pixels: npt.NDArray[Any]) -> Features:
        assert self._elf is not None  # there are images
        return self._elf.detect(pixels, mask=self._mask, **options.settings(self._args))

    def _keep(self, index: int, features: Features) -> None:
        """Keep features in memory; of those that no longer fit, put the ones used least recently aside."""
        self._kept[index] = features
        self._in_memory += _bytes(features)
        while len(self._kept) > 2 and self._in_memory > MOST_BYTES:
            oldest, found = self._kept.popitem(last=False)
            self._in_memory -= _bytes(found)
            if oldest not in self._records and oldest not in self._put_aside:
                if self._folder is None:
                    self._folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="elf-match-")))
                found.save(self._folder / f"{oldest}.npz")
                self._put_aside.add(oldest)

    def camera(self, index: int, given: Intrinsics | None) -> Float:
        """The calibration matrix of an image: as it is given, or with EXIF's focal length and the middle of the image.

        Raises
        ------
        ElfError
            If it is not given, and the file says none.
        """
        size = self.features(index).image_size
        if given is None:
            focal = focal_length_px(self._image(index))
            if focal is None:
                raise ElfError(f"{self._image(index)}: no focal length in its EXIF data; give --K")
            given = Intrinsics((focal, focal))
        return given.matrix(size)

    def pixels(self, index: int) -> npt.NDArray[Any]:
        """The image, to draw on or to refine by; of a feature file, that which its record names.

        The two used last are kept.

        Raises
        ------
        ElfError
            If it can't be read, or is not the one, or of the size, that the features were made from.
        """
        if index in self._seen:
            self._seen.move_to_end(index)
            return self._seen[index]
        path, record = self._image(index), self._records.get(index) or {}
        stored = bool(record.get("ignore_exif", self._args.ignore_exif))
        file = ImageFile(path, self._args.max_pixels)
        found = file.decoded(stored)
        if found.shape[:2] != tuple(self.features(index).image_size):
            raise ElfError(f"{path}: it is no longer of the size that {self.paths[index]} was made from")
        if (digest := record.get("image_sha256")) is not None and digest != file.sha256:
            raise ElfError(f"{path}: it is no longer the image that {self.paths[index]} was made from")
        self._seen[index] = found
        if len(self._seen) > 2:
            self._seen.popitem(last=False)
        return found

    def _image(self, index: int) -> Path:
        if index not in self._records:
            return self.paths[index]
        name = (self._records[index] or {}).get("image")
        if not isinstance(name, str) or not Path(name).is_file():
            what = f"its image {name} is not there" if isinstance(name, str) else "it does not name its image"
            raise ElfError(f"{self.paths[index]}: {what}")
        return Path(name)

    def nearest(self, count: int, query: bool) -> Pairs:
        """The pairs of each image, or of the first one alone, with those nearest by `global_descriptor`, in order.

        An image that fails has none.
        """
        pooled: dict[int, npt.NDArray[np.float32]] = {}
        for index in range(len(self.paths)):
            try:
                pooled[index] = global_descriptor(self.features(index))
                width = len(next(iter(pooled.values())))
                if len(pooled[index]) != width:
                    del pooled[index]
                    raise ElfError(f"{self.paths[index]}: its descriptors have another length than the others'")
            except SettingError as error:
                self._errors[index] = f"{self.paths[index]}: {error}"
            except (ElfError, OSError) as error:
                self._errors[index] = text_of(error)
        if not pooled or (query and 0 not in pooled):
            return []
        places = list(pooled)
        rows = np.stack(list(pooled.values()))
        if query:
            return [(0, places[j]) for j in nearest(rows, count)[0]]
        return [(places[i], places[j]) for i, j in nearest_pairs(rows, count)]

    def _agreed(self) -> dict[str, Any]:
        """Where the features come from, all of them; what their records differ in is refused or said."""
        known = {self.paths[i]: record for i, record in self._records.items() if record is not None}
        if self._elf is not None:
            origin, what = options.origin(self._elf, self._args), f"the model {self._args.model or 'bundled'}"
            check_records(known, origin | {"ignore_exif": self._args.ignore_exif}, what)
        else:
            first, ours = next(iter(known.items()), ("", {}))
            kept = ("model_sha256", "network", "layer", "descriptor", "settings")
            origin = {"model": None, "provider": None} | {name: ours.get(name) for name in kept}
            check_records(known, ours, str(first))
        unknown = [self.paths[i] for i in self._records if self.paths[i] not in known and self.paths[i].is_file()]
        if unknown:
            warn(f"{unknown[0]}{and_more(unknown)}: no record of a model; taken to be the same")
        return origin


def _bytes(features: Features) -> int:
    return features.descriptors.nbytes + features.keypoints.nbytes + 3 * features.scores.nbytes
