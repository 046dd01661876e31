"""Keypoints that a graph gives itself: a file of ``elf-export --end-to-end``."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any, NoReturn

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.contract import DescriptorSpec, EndToEndSpec, InputSpec
from elf_runtime.detection.descriptors import Array
from elf_runtime.detection.working_image import check_least
from elf_runtime.errors import ImageError, ModelError, SettingError
from elf_runtime.image import convert, masks
from elf_runtime.model.network import Network, alone_feed
from elf_runtime.model.outputs import check_saliency
from elf_runtime.params import DetectionParams
from elf_runtime.results.features import Features
from elf_runtime.results.trace import Stopwatch, Trace

FREE = ("max_keypoints", "threshold")
"""The settings that are inputs of the graph; the mask is one, too."""


@dataclass(frozen=True)
class Given:
    """An image as the graph takes it, (H, W, C), and where keypoints may be, (H, W) uint8; None is everywhere."""

    pixels: npt.NDArray[Any]
    mask: npt.NDArray[np.uint8] | None


class Alone:
    """What `OpenedModel` does with a graph that gives keypoints; `maps.Maps` is the same for one that gives maps."""

    def __init__(self, network: Network) -> None:
        self._network, self.contract = network, network.contract
        self._form = network.contract.end_to_end or EndToEndSpec()

    def check(self, params: DetectionParams) -> None:
        """Raise SettingError on a setting that is another one in the graph."""
        own = self.contract.detection
        names = [field.name for field in fields(params) if field.name not in FREE]
        changed = [name for name in names if getattr(params, name) != getattr(own, name)]
        if changed:
            self._refuse(f"{', '.join(changed)} can't be changed; {', '.join(FREE)} and a mask can be given")

    def _refuse(self, what: str) -> NoReturn:
        raise SettingError(f"{self._network.name} gives keypoints itself (elf-export --end-to-end): {what}")

    def prepare(self, image: npt.NDArray[Any], params: DetectionParams, mask: npt.ArrayLike | None) -> Given:
        """The image in the order of channels and the range that the graph takes."""
        if self._form.pixels == "float32":
            pixels: npt.NDArray[Any] = convert.to_pixels(image, InputSpec(color=self._form.color))
        else:
            pixels = convert.checked(image)
            if pixels.dtype != np.uint8:
                raise ImageError(
                    f"{self._network.name} takes pixels of 8 bits, not {pixels.dtype}: convert them, or export it with "
                    "--end-to-end float32"
                )
            pixels = pixels[:, :, None] if pixels.ndim == 2 else pixels
            pixels = pixels[:, :, ::-1] if self._form.color == "rgb" else pixels
        check_least((image.shape[0], image.shape[1]), self.contract.input)
        allowed = masks.seen(image, mask)
        return Given(np.ascontiguousarray(pixels), None if allowed is None else allowed.view(np.uint8))

    def together(self, image: Given) -> Hashable:
        """Images of one size can be a batch, unless they have masks: there is one for all in the graph."""
        return image.pixels.shape if image.mask is None else id(image)

    def most_together(self, batch_size: int) -> int:
        """How many at once, where `batch_size` are wanted."""
        return batch_size if self._form.batch else 1

    def traces(
        self, group: Sequence[Given], params: DetectionParams, spec: DescriptorSpec | None, watch: Stopwatch
    ) -> Iterator[Trace]:
        """The detections of images that go through the network together; without what led to them."""
        names = self._names(spec)
        with watch("session"):
            found = self._network.fetched(names, *self._feed(group, params))
        for i in range(len(group)):
            rows = {name: value[i] if self._form.batch else value for name, value in found.items()}
            count = int(rows.pop("counts", len(rows["scores"])))
            points, scores, descriptors = (
                rows.get(name, np.zeros((count, 0), np.float32))[:count]
                for name in ("keypoints", "scores", "descriptors")
            )
            shapes = ((count, 2), (count,), (count, spec.dim if spec else 0))
            if (points.shape, scores.shape, descriptors.shape) != shapes or not np.isfinite(descriptors).all():
                raise ModelError(f"{self._network.name}: its outputs are no keypoints, or NaN or infinite")
            size = (group[i].pixels.shape[0], group[i].pixels.shape[1])
            yield Trace(Features(points, scores, descriptors, size, params.nms_radius), (), watch.seconds)

    def _feed(
        self, group: Sequence[Given], params: DetectionParams
    ) -> tuple[dict[str, npt.NDArray[Any]], tuple[int, int, int]]:
        """The graph's inputs, and the images' shape (N, H, W)."""
        pixels = np.stack([one.pixels for one in group])
        shape = (pixels.shape[0], pixels.shape[1], pixels.shape[2])
        # A batch is padded to max_keypoints, and the graph's input is an int64: ask for no more than there are pixels.
        most = math.prod(self.contract.input.size_for(shape[1], shape[2], max(params.scale, 1.0)))
        params = params.updated(max_keypoints=min(params.max_keypoints, most))
        return alone_feed(pixels, params, group[0].mask), shape

    def saliency(self, image: Given) -> Array:
        """The saliency map at the size of the source image, of a graph that gives it; zero for a flat image."""
        if not self._form.saliency:
            self._refuse("it has no saliency map (--end-to-end saliency)")
        height, width = image.pixels.shape[:2]
        if convert.is_flat(image.pixels):
            return np.zeros((height, width), np.float32)
        name = self.contract.saliency_output
        found = self._network.fetched([name], *self._feed([image], self.contract.detection))[name]
        check_saliency(found, (1, *found.shape[1:]), self._network.name)
        return np.asarray(cv2.resize(found[0], (width, height), interpolation=cv2.INTER_LINEAR))

    def described(self, image: Given, points: Any, params: DetectionParams, spec: DescriptorSpec) -> Array:
        """A graph that gives keypoints describes these only."""
        self._refuse("it can't describe others")

    def expect(self, image: Given, params: DetectionParams) -> None:
        """Open the session of images of this size, which are to come."""
        height, width = image.pixels.shape[:2]
        self._network.sessions.get(self._names(self.contract.descriptor()), (1, height, width), expected=True)

    def _names(self, spec: DescriptorSpec | None) -> list[str]:
        return ["keypoints", "scores", *["descriptors"] * (spec is not None), *["counts"] * self._form.batch]
