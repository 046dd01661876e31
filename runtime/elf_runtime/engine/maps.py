"""Keypoints of the maps that a graph gives: saliency and descriptors."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.contract import DescriptorSpec, ModelContract
from elf_runtime.detection.descriptors import Array, DescriptorMap, as_points
from elf_runtime.detection.detect import Seen, detect, nothing_found
from elf_runtime.detection.upright import Sheet, UprightPatches
from elf_runtime.detection.working_image import Levels, WorkingImage, nearest_level, prepare
from elf_runtime.model.network import Network
from elf_runtime.params import DetectionParams
from elf_runtime.results.trace import Stopwatch, Trace


class Maps:
    """What `OpenedModel` does with a graph that gives maps; `alone.Alone` is the same for one that gives keypoints."""

    def __init__(self, network: Network) -> None:
        self._network = network

    @property
    def contract(self) -> ModelContract:
        return self._network.contract

    def check(self, params: DetectionParams) -> None:
        """Any setting can be changed."""

    def prepare(self, image: npt.NDArray[Any], params: DetectionParams, mask: npt.ArrayLike | None) -> Levels:
        """See `working_image.prepare`."""
        return prepare(image, params, mask, self.contract, self._network.name)

    def together(self, image: Levels) -> Hashable:
        """Images of which this is the same can go through the network together."""
        return tuple(one.scaling.working for one in image)

    def most_together(self, batch_size: int) -> int:
        """How many at once, where `batch_size` are wanted."""
        return self.contract.input.batch or batch_size

    def traces(
        self, group: Sequence[Levels], params: DetectionParams, spec: DescriptorSpec | None, watch: Stopwatch
    ) -> Iterator[Trace]:
        """The detections of images that go through the network together."""
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

    def saliency(self, image: Levels) -> Array:
        """The saliency map of the finest level, at the size of the source image."""
        working = image[0]
        height, width = working.scaling.source
        if not working.textured:
            return np.zeros((height, width), np.float32)
        found: Array = self._network.run([working.pixels], None)[self.contract.saliency_output][0]
        if found.shape == (height, width):
            return found
        return np.asarray(cv2.resize(found, (width, height), interpolation=cv2.INTER_LINEAR))

    def described(self, levels: Levels, points: Any, params: DetectionParams, spec: DescriptorSpec) -> Array:
        """Descriptors at points, each at its own working scale where there are several: see `ElfRuntime.describe`."""
        where = as_points(points)
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

    def expect(self, levels: Levels, params: DetectionParams) -> None:
        """Open the sessions of images such as this one, which are to come."""
        spec = self.contract.descriptor()
        for image in levels:
            mapped = None if params.oriented else spec
            self._network.expect(image.scaling.working, mapped, levels=len(levels))
        if params.oriented and spec is not None:
            self._network.expect(Sheet.of(self.contract.input, spec).size, spec, saliency=False)
