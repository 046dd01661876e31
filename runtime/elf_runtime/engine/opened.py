"""A model that is open, and what a call to it is turned into: settings, and an image at the working size."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby, islice
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from elf_runtime.contract import DescriptorSpec, ModelContract
from elf_runtime.detection.descriptors import Array
from elf_runtime.errors import ImageError, SettingError
from elf_runtime.image.file import COLORS, ImageLike, check_pixels, image_errors
from elf_runtime.model.network import Network
from elf_runtime.model.session import read_model
from elf_runtime.params import DetectionParams
from elf_runtime.presets import preset
from elf_runtime.results.trace import Stopwatch, Trace
from elf_runtime.values import is_int

from .alone import Alone
from .maps import Maps
from .origin import Prepared, read_with_source, record_of


class OpenedModel:
    """What `ElfRuntime` is built on, with the work behind its methods; users see that class only."""

    _network_kind: ClassVar[type[Network]] = Network  # another one may remember what it computed

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
        self._network = self._network_kind(None if model is None else read_model(model), session_options, int(sizes))
        self._way: Maps | Alone = (Maps if self.contract.end_to_end is None else Alone)(self._network)

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
            On an unknown preset or setting, a value out of range, a preset and `params` together, or a setting that is
            frozen in a file that gives keypoints itself.
        """
        if params is not None:
            if not isinstance(params, DetectionParams):
                raise SettingError(f"params is a DetectionParams, not {type(params).__name__}")
            if name is not None:
                raise SettingError(f"preset {name!r} and params are both where to start from; give one of them")
            return self._allowed(params.updated(**settings))
        base = self.contract.detection if name in (None, "default") else preset(name, self.contract.network)
        if self.contract.input.is_fixed:
            base = base.updated(scale=1.0)
        return self._allowed(base.updated(**settings))

    def _allowed(self, params: DetectionParams) -> DetectionParams:
        self._way.check(params)
        return params

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
            return Prepared(self._way.prepare(pixels, params, mask), source)

    def _traces(
        self, group: Sequence[Prepared], params: DetectionParams, spec: DescriptorSpec | None, watch: Stopwatch
    ) -> Iterator[Trace]:
        """The detections of images that go through the network together."""
        found = self._way.traces([image.image for image in group], params, spec, watch)
        for image, trace in zip(group, found, strict=True):
            record = record_of(self._network, params, spec, image.source)
            yield replace(trace, features=replace(trace.features, record=record))

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
        most = self._way.most_together(batch_size)
        for _, same in groupby(prepared, key=lambda one: self._way.together(one.image)):
            while group := list(islice(same, most)):
                yield from self._traces(group, params, spec, Stopwatch())

    def _saliency(self, image: ImageLike, params: DetectionParams) -> Array:
        """The saliency map of the finest working scale, at the size of the source image."""
        return self._way.saliency(self._prepare(image, params.updated(scale=params.working_scales[0])).image)

    def _described(self, image: ImageLike, points: Any, params: DetectionParams, spec: DescriptorSpec) -> Array:
        """Descriptors at points: see `ElfRuntime.describe`."""
        return self._way.described(self._prepare(image, params).image, points, params, spec)

    def _warm(self, size: tuple[int, int], params: DetectionParams) -> None:
        """Open the session of (height, width) and detect on noise of this size, which is checked before it is made."""
        if not (isinstance(size, Sequence) and len(size) == 2 and all(is_int(side) and side > 0 for side in size)):
            raise SettingError(f"a size is (height, width) in pixels, not {size!r}")
        check_pixels(size, self._max_pixels)
        noise = np.random.default_rng(0).integers(0, 256, (*size, 3), np.uint8)
        prepared = self._prepare(noise, params)
        self._way.expect(prepared.image, params)
        list(self._traces([prepared], params, self.contract.descriptor(), Stopwatch()))
