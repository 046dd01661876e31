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
from elf_runtime.detection.oriented import Oriented
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
                seen = [self._seen(image, maps, i, mapped) for image, maps in zip(levels, outputs, strict=True)]
                yield detect(seen, params, watch, self._oriented(levels, params, spec) if params.oriented else None)
            else:
                yield nothing_found(levels, spec.dim if spec else 0, params, watch)

    def _seen(self, image: WorkingImage, maps: Mapping[str, Array], index: int, spec: DescriptorSpec | None) -> Seen:
        """An image with its part of what the network gives for a batch."""
        described = DescriptorMap(maps[spec.output][index], spec, self._network.name) if spec else None
        return Seen(image, maps[self.contract.saliency_output][index], described)

    def _map(self, pixels: Array, spec: DescriptorSpec, levels: int = 1) -> DescriptorMap:
        """The descriptor map of one image, which is one of `levels`."""
        maps = self._network.run([pixels], spec, saliency=False, levels=levels)
        return DescriptorMap(maps[spec.output][0], spec, self._network.name)

    def _oriented(self, levels: Levels, params: DetectionParams, spec: DescriptorSpec | None) -> Oriented:
        look = None if spec is None else partial(self._map, spec=spec)
        sheet, dim = Sheet.of(self.contract.input, spec), spec.dim if spec else 0
        patches = [UprightPatches(image.pixels, sheet, look, dim) for image in levels]
        return Oriented(levels, patches, params.nms_radius)

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
        count = len(where)
        sizes, angles = np.zeros(count, np.float32), np.full(count, -1, np.float32)
        if count and hasattr(points[0], "pt"):
            sizes, angles = np.array([(point.size, point.angle) for point in points], np.float32).T
        if params.oriented:
            oriented = self._oriented(levels, params, spec)
            lost = ~(sizes > 0)
            if lost.any():
                sizes[lost] = oriented.sizes(0, levels[0].scaling.to_working(where[lost]))
            return oriented.described(where, sizes, np.where(angles >= 0, angles, -1))[1]
        descriptors = np.zeros((count, spec.dim), np.float32)
        level = np.where(sizes > 0, nearest_level(sizes, levels, params.nms_radius), 0)
        for number in np.unique(level):
            working, own = levels[number], level == number
            places = working.scaling.to_working(where[own])
            descriptors[own] = self._map(working.pixels, spec, len(levels)).at(places)
        return descriptors

    def expect(self, levels: Levels, params: DetectionParams) -> None:
        """Open the sessions of images such as this one, which are to come."""
        spec = self.contract.descriptor()
        for image in levels:
            mapped = None if params.oriented else spec
            self._network.expect(image.scaling.working, mapped, levels=len(levels))
        if params.oriented and spec is not None:
            self._network.expect(Sheet.of(self.contract.input, spec).size, spec, saliency=False)
