"""A model that is open, and what a call to it is turned into: settings, and an image at the working size."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby, islice
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.contract import DescriptorSpec, ModelContract
from elf_runtime.detection.descriptors import Array, DescriptorMap, as_points
from elf_runtime.detection.detect import Seen, detect, nothing_found
from elf_runtime.detection.upright import Sheet, UprightPatches
from elf_runtime.detection.working_image import Levels, WorkingImage, nearest_level, prepare
from elf_runtime.errors import ImageError, SettingError
from elf_runtime.image.file import COLORS, ImageLike, check_pixels, image_errors
from elf_runtime.model.network import Network
from elf_runtime.model.session import read_model
from elf_runtime.params import DetectionParams
from elf_runtime.presets import preset
from elf_runtime.results.trace import Stopwatch, Trace
from elf_runtime.values import is_int

from .origin import Prepared, read_with_source, record_of


class OpenedModel:
    """What `ElfRuntime` is built on, with the work behind its methods; users see that class only."""

    def __init__(
        self,
        model: str | os.PathLike[str] | bytes | None,
        session_options: Mapping[str, Any],
        sizes: int,
        max_pixels: int | None,
        color: str,
    ) -> None:
        if not is_int(sizes) or sizes < 0:
            raise SettingError(f"sizes is an integer >= 0, not {sizes!r}")
        if max_pixels is not None and (not is_int(max_pixels) or max_pixels < 1):
            raise SettingError(f"max_pixels is None or an integer >= 1, not {max_pixels!r}")
        if color not in COLORS:
            raise SettingError(f"color is 'bgr' or 'rgb', not {color!r}")
        self._max_pixels, self._color = max_pixels, color
        self._network = Network(None if model is None else read_model(model), session_options, int(sizes))

    @property
    def contract(self) -> ModelContract:
        """What the model file says of itself."""
        return self._network.contract

    @property
    def providers(self) -> list[str]:
        """Names of the active execution providers, the preferred one first."""
        return self._network.sessions.providers

    @property
    def sha256(self) -> str:
        """SHA-256 of the model's file."""
        return self._network.sessions.sha256

    def __repr__(self) -> str:
        c = self.contract
        layers = ",".join(d.layer for d in c.descriptors) or "none"
        name = type(self).__name__
        return f"{name}({self._network.name!r}: {c.network} {c.layer}, descriptors {layers}, {self.providers[0]})"

    def params(
        self, name: str | None = None, *, params: DetectionParams | None = None, **settings: Any
    ) -> DetectionParams:
        """The settings that a call with this preset, or these `params`, and these changes uses.

        A preset's scale or scales are not for a model that takes one size only: there it is 1.

        Raises
        ------
        SettingError
            On an unknown preset or setting, a value out of range, or a preset and `params` together.
        """
        if params is not None:
            if not isinstance(params, DetectionParams):
                raise SettingError(f"params is a DetectionParams, not {type(params).__name__}")
            if name is not None:
                raise SettingError(f"preset {name!r} and params are both where to start from; give one of them")
            return params.updated(**settings)
        base = self.contract.detection if name in (None, "default") else preset(name, self.contract.network)
        if self.contract.input.is_fixed:
            base = base.updated(scale=1.0)
        return base.updated(**settings)

    def _prepare(
        self,
        image: ImageLike,
        params: DetectionParams,
        mask: npt.ArrayLike | None = None,
        place: str = "",
        watch: Stopwatch | None = None,
    ) -> Prepared:
        """Read the image and make it ready; `place` says which of a batch it is, for what is wrong with it."""
        watch = watch or Stopwatch()
        with watch("read"):
            pixels, source = read_with_source(image, self._max_pixels, self._color)
        with watch("prepare"), image_errors(image, place):
            check_pixels(pixels.shape, self._max_pixels)
            return Prepared(prepare(pixels, params, mask, self.contract, self._network.name), source)

    def _traces(
        self, group: Sequence[Prepared], params: DetectionParams, spec: DescriptorSpec | None, watch: Stopwatch
    ) -> Iterator[Trace]:
        """The detections of images of the same working sizes, which go through the network together."""
        found = self._detections([image.levels for image in group], params, spec, watch)
        for image, trace in zip(group, found, strict=True):
            record = record_of(self._network, params, spec, image.source)
            yield replace(trace, features=replace(trace.features, record=record))

    def _detections(
        self, group: Sequence[Levels], params: DetectionParams, spec: DescriptorSpec | None, watch: Stopwatch
    ) -> Iterator[Trace]:
        textured = [levels for levels in group if levels[0].textured]
        mapped = None if params.oriented else spec
        with watch("session"):
            outputs = [
                self._network.run([image.pixels for image in same_size], mapped, levels=len(group[0]))
                for same_size in zip(*textured, strict=True)
            ]
        order = iter(range(len(textured)))
        for levels in group:
            if levels[0].textured:
                i = next(order)
                seen = [self._seen(image, maps, i, params, spec) for image, maps in zip(levels, outputs, strict=True)]
                yield detect(seen, params, watch)
            else:
                yield nothing_found(levels, spec.dim if spec else 0, params, watch)

    def _seen(
        self,
        image: WorkingImage,
        maps: Mapping[str, Array],
        index: int,
        params: DetectionParams,
        spec: DescriptorSpec | None,
    ) -> Seen:
        """An image with its part of what the network gives for a batch."""
        saliency = maps[self.contract.saliency_output][index]
        if params.oriented:
            return Seen(image, saliency, None, self._upright(image, spec))
        described = DescriptorMap(maps[spec.output][index], spec, self._network.name) if spec else None
        return Seen(image, saliency, described)

    def _map(self, pixels: Array, spec: DescriptorSpec, levels: int = 1) -> DescriptorMap:
        """The descriptor map of one image, which is one of `levels`."""
        maps = self._network.run([pixels], spec, saliency=False, levels=levels)
        return DescriptorMap(maps[spec.output][0], spec, self._network.name)

    def _upright(self, image: WorkingImage, spec: DescriptorSpec | None) -> UprightPatches:
        look = None if spec is None else partial(self._map, spec=spec)
        return UprightPatches(image.pixels, Sheet.of(self.contract.input, spec), look, spec.dim if spec else 0)

    def _batches(
        self,
        batch: Sequence[ImageLike],
        masks: Iterable[npt.ArrayLike | None] | None,
        params: DetectionParams,
        spec: DescriptorSpec | None,
        batch_size: int,
    ) -> Iterator[Trace]:
        """`_traces` of images of any sizes; neighbours of one size go through the network together."""
        if not is_int(batch_size) or batch_size < 1:
            raise SettingError(f"batch_size is an integer >= 1, not {batch_size!r}")
        if isinstance(batch, (str, bytes, os.PathLike)):
            raise SettingError(f"a batch is a list of images, not {batch!r}; give [{batch!r}]")
        batch = list(batch)
        all_masks = [None] * len(batch) if masks is None else list(masks)
        if len(all_masks) != len(batch):
            raise ImageError(f"{len(all_masks)} masks for {len(batch)} images")
        pairs = enumerate(zip(batch, all_masks, strict=True))
        prepared = (self._prepare(image, params, mask, f"image {i} of the batch") for i, (image, mask) in pairs)
        for _, same_size in groupby(prepared, key=lambda one: [image.scaling.working for image in one.levels]):
            while group := list(islice(same_size, self.contract.input.batch or batch_size)):
                yield from self._traces(group, params, spec, Stopwatch())

    def _saliency(self, image: ImageLike, params: DetectionParams) -> Array:
        """The saliency map of the finest working scale, at the size of the source image."""
        (working,) = self._prepare(image, params.updated(scale=params.working_scales[0])).levels
        height, width = working.scaling.source
        if not working.textured:
            return np.zeros((height, width), np.float32)
        found: Array = self._network.run([working.pixels], None)[self.contract.saliency_output][0]
        if found.shape == (height, width):
            return found
        return np.asarray(cv2.resize(found, (width, height), interpolation=cv2.INTER_LINEAR))

    def _described(self, image: ImageLike, points: Any, params: DetectionParams, spec: DescriptorSpec) -> Array:
        """Descriptors at points, each at its own working scale where there are several: see `ElfRuntime.describe`."""
        where = as_points(points)
        levels = self._prepare(image, params).levels
        found = np.zeros((len(where), spec.dim), np.float32)
        level, angles = np.zeros(len(where), np.int64), np.full(len(where), -1.0)
        if len(where) and hasattr(points[0], "pt"):
            angles = np.array([point.angle for point in points])
            level = nearest_level([point.size for point in points], levels, params.nms_radius)
        for number in np.unique(level):
            working, own = levels[number], level == number
            places = working.scaling.to_working(where[own])
            if params.oriented:
                upright = self._upright(working, spec)
                given = np.isfinite(angles[own]) & (angles[own] >= 0)
                turned = np.where(given, angles[own], upright.angles(places))
                found[own] = upright.at(places, turned)
            else:
                found[own] = self._map(working.pixels, spec, len(levels)).at(places)
        return found

    def _warm(self, size: tuple[int, int], params: DetectionParams) -> None:
        """Open the session of (height, width) and detect on noise of this size, which is checked before it is made."""
        if not (isinstance(size, Sequence) and len(size) == 2 and all(is_int(side) and side > 0 for side in size)):
            raise SettingError(f"a size is (height, width) in pixels, not {size!r}")
        check_pixels(size, self._max_pixels)
        noise = np.random.default_rng(0).integers(0, 256, (*size, 3), np.uint8)
        prepared, spec = self._prepare(noise, params), self.contract.descriptor()
        for image in prepared.levels:
            mapped = None if params.oriented else spec
            self._network.expect(image.scaling.working, mapped, levels=len(prepared.levels))
        if params.oriented and spec is not None:
            self._network.expect(Sheet.of(self.contract.input, spec).size, spec, saliency=False)
        list(self._traces([prepared], params, spec, Stopwatch()))
