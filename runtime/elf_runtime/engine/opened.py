"""A model that is open, and what a call to it is turned into: settings, and an image at the working size."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby, islice
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.contract import DescriptorSpec, ModelContract
from elf_runtime.detection.descriptors import Array, DescriptorMap
from elf_runtime.detection.detect import detect, nothing_found
from elf_runtime.detection.working_image import WorkingImage, prepare
from elf_runtime.errors import ImageError, SettingError
from elf_runtime.image.file import ImageLike, check_pixels, image_errors, read
from elf_runtime.model.network import Network
from elf_runtime.model.session import read_model
from elf_runtime.params import DetectionParams, is_int
from elf_runtime.presets import preset
from elf_runtime.results.trace import Stopwatch, Trace


class OpenedModel:
    """What `ElfRuntime` is built on, with the work behind its methods; users see that class only."""

    def __init__(
        self,
        model: str | os.PathLike[str] | bytes | None,
        session_options: Mapping[str, Any],
        sizes: int,
        max_pixels: int | None,
    ) -> None:
        if not is_int(sizes) or sizes < 0:
            raise SettingError(f"sizes is an integer >= 0, not {sizes!r}")
        if max_pixels is not None and (not is_int(max_pixels) or max_pixels < 1):
            raise SettingError(f"max_pixels is None or an integer >= 1, not {max_pixels!r}")
        self._max_pixels = max_pixels
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

        A preset's scale is not for a model that takes one size only: there it is 1.

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
    ) -> WorkingImage:
        """Read the image and make it ready; `place` says which of a batch it is, for what is wrong with it."""
        watch = watch or Stopwatch()
        with watch("read"):
            pixels = read(image, max_pixels=self._max_pixels)
        with watch("prepare"), image_errors(image, place):
            check_pixels(pixels.shape, self._max_pixels)
            return prepare(pixels, params, mask, self.contract, self._network.name)

    def _traces(
        self, group: Sequence[WorkingImage], params: DetectionParams, spec: DescriptorSpec | None, watch: Stopwatch
    ) -> Iterator[Trace]:
        """The detections of images of one working size, which go through the network together."""
        pixels = [image.pixels for image in group if image.textured]
        with watch("session"):
            outputs = self._network.run(pixels, spec) if pixels else {}
        order = iter(range(len(pixels)))
        for image in group:
            if image.textured:
                i = next(order)
                described = DescriptorMap(outputs[spec.output][i], spec, self._network.name) if spec else None
                yield detect(image, outputs[self.contract.saliency_output][i], described, params, watch)
            else:
                yield nothing_found(image, spec.dim if spec else 0, params, watch)

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
        for _, same_size in groupby(prepared, key=lambda working: working.scaling.working):
            while group := list(islice(same_size, self.contract.input.batch or batch_size)):
                yield from self._traces(group, params, spec, Stopwatch())

    def _saliency(self, working: WorkingImage) -> Array:
        """The saliency map at the size of the source image."""
        height, width = working.scaling.source
        if not working.textured:
            return np.zeros((height, width), np.float32)
        found: Array = self._network.run([working.pixels], None)[self.contract.saliency_output][0]
        if found.shape == (height, width):
            return found
        return np.asarray(cv2.resize(found, (width, height), interpolation=cv2.INTER_LINEAR))

    def _warm(self, size: tuple[int, int], params: DetectionParams) -> None:
        """Open the session of (height, width) and detect on noise of this size, which is checked before it is made."""
        if not (isinstance(size, Sequence) and len(size) == 2 and all(is_int(side) and side > 0 for side in size)):
            raise SettingError(f"a size is (height, width) in pixels, not {size!r}")
        check_pixels(size, self._max_pixels)
        noise = np.random.default_rng(0).integers(0, 256, (*size, 3), np.uint8)
        working, spec = self._prepare(noise, params), self.contract.descriptor()
        self._network.expect(working.scaling.working, spec)
        list(self._traces([working], params, spec, Stopwatch()))
