"""`ElfRuntime`: the saliency, keypoints and descriptors of images, by one model."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby, islice
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.contract import DescriptorSpec
from elf_runtime.detection.descriptors import Array, DescriptorMap, as_points
from elf_runtime.detection.detect import detect, nothing_found
from elf_runtime.detection.working_image import WorkingImage
from elf_runtime.errors import ImageError, SettingError
from elf_runtime.image.file import ImageLike
from elf_runtime.params import DetectionParams, is_int
from elf_runtime.results.features import Features
from elf_runtime.results.trace import Stopwatch, Trace

from .opened import OpenedModel


class ElfRuntime(OpenedModel):
    """Runs an ELF model: saliency graph, threshold, non-maximum suppression, descriptors.

    An instance is safe to use from several threads at once.  Copied or pickled, for a pool of processes, it opens its
    model again.

    `detect` runs the whole graph; the first call of `saliency` or `describe` opens a session of that part of the graph
    alone.  A model in ORT format, or with nodes like If and Loop, can't be cut: there they run the whole graph too.
    """

    def detect(
        self,
        image: ImageLike,
        max_keypoints: int | None = None,
        threshold: str | float | None = None,
        nms_radius: int | None = None,
        border: int | None = None,
        mask: npt.ArrayLike | None = None,
        preset: str | None = None,
        scale: float | None = None,
        descriptor: str | None = None,
        **settings: Any,
    ) -> Features:
        """Detect keypoints and describe them.

        Parameters
        ----------
        image : (H, W), (H, W, 3) or (H, W, 4) array, or path
            BGR (as OpenCV reads) or grey; a fourth channel is alpha, and there are no keypoints where it is 0.  uint8,
            uint16, or float in [0, 1]; 32x32 pixels or more.
        max_keypoints : int
            The strongest that many are kept.  Fewer come where fewer maxima pass the threshold.
        threshold : "kapur", "none" or float in [0, 1]
            See `DetectionParams`; "none" takes weak maxima too, for more keypoints than Kapur's level lets through.
        nms_radius, border : int
            In pixels of the source image; see `DetectionParams`.
        mask : (H, W) bool or integer array, optional
            Keypoints only where it is non-zero, at the pixel that a keypoint's x and y round to, and not so near to its
            edge that the network sees what lies behind: see ``mask_border`` of `DetectionParams`.  An alpha channel of
            the image is a mask too.
        preset : str, optional
            "fast", "default" (the model's own settings), "accurate", or the paper's: "paper", "paper-webcam",
            "paper-robust", "paper-components".  Where to start from.  Its scale is not for a model of one size only.
        scale : float
            Working scale: 0.5 lets the network see the image at half width and height.
        descriptor : str, optional
            Which of the model's descriptor layers; the first by default.
        **settings
            Any other field of `DetectionParams`; or ``params=DetectionParams(...)``, where to start from in place of a
            preset.  What is None or absent is that of `params`, else the preset's, else the model's.

        Returns
        -------
        Features
            Nothing found (a flat image, an empty mask) is (0, 2), (0,), (0, D).

        Raises
        ------
        ImageError
            On an image or mask that can't be processed.
        SettingError
            On a setting out of range or unknown.
        """
        settings |= {"max_keypoints": max_keypoints, "threshold": threshold, "nms_radius": nms_radius}
        settings |= {"border": border, "scale": scale}
        return self.trace(image, mask=mask, preset=preset, descriptor=descriptor, **settings).features

    def trace(
        self,
        image: ImageLike,
        *,
        mask: npt.ArrayLike | None = None,
        preset: str | None = None,
        descriptor: str | None = None,
        **settings: Any,
    ) -> Trace:
        """As `detect`, with the saliency, the scores, the threshold mask and the time of each stage."""
        params = self.params(preset, **settings)
        spec, watch = self.contract.descriptor(descriptor), Stopwatch()
        return next(self._traces([self._prepare(image, params, mask, watch=watch)], params, spec, watch))

    def detect_batch(
        self,
        batch: Sequence[ImageLike],
        *,
        masks: Iterable[npt.ArrayLike | None] | None = None,
        preset: str | None = None,
        descriptor: str | None = None,
        batch_size: int = 4,
        **settings: Any,
    ) -> list[Features]:
        """`detect` for several images; neighbours of one size go through the network together.

        Parameters
        ----------
        batch : sequence of images
            Sizes may differ.
        masks : iterable of masks or None, one per image, optional
        batch_size : int
            At most so many images at once: memory grows with it.

        Returns
        -------
        list of Features, one per image, each the same as `detect` gives up to float32's rounding, which moves a value
        of an int8 model by a step of its 8 bits here and there
        """
        if not is_int(batch_size) or batch_size < 1:
            raise SettingError(f"batch_size is an integer >= 1, not {batch_size!r}")
        batch = list(batch)
        all_masks = [None] * len(batch) if masks is None else list(masks)
        if len(all_masks) != len(batch):
            raise ImageError(f"{len(all_masks)} masks for {len(batch)} images")
        params, spec = self.params(preset, **settings), self.contract.descriptor(descriptor)
        pairs = enumerate(zip(batch, all_masks, strict=True))
        prepared = (self._prepare(image, params, mask, f"image {i} of the batch") for i, (image, mask) in pairs)
        found: list[Features] = []
        for _, same_size in groupby(prepared, key=lambda working: working.scaling.working):
            while group := list(islice(same_size, self.contract.input.batch or batch_size)):
                found += [trace.features for trace in self._traces(group, params, spec, Stopwatch())]
        return found

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

    def saliency(
        self,
        image: ImageLike,
        scale: float | None = None,
        preset: str | None = None,
        params: DetectionParams | None = None,
    ) -> Array:
        """The saliency map S(I) = |F^T dF/dI|, averaged over the image's channels.

        `scale`, and `preset` or `params`, whose scale it is otherwise, are those of `detect`.

        Returns
        -------
        (H, W) float32
            At the size of the source image (interpolated where the working scale is not 1); zero for a flat image.
        """
        working = self._prepare(image, self.params(preset, params=params, scale=scale))
        height, width = working.scaling.source
        if not working.textured:
            return np.zeros((height, width), np.float32)
        found: Array = self._network.run([working.pixels], None)[self.contract.saliency_output][0]
        if found.shape == (height, width):
            return found
        return np.asarray(cv2.resize(found, (width, height), interpolation=cv2.INTER_LINEAR))

    def describe(
        self,
        image: ImageLike,
        points: Any,
        descriptor: str | None = None,
        scale: float | None = None,
        preset: str | None = None,
        params: DetectionParams | None = None,
    ) -> Array:
        """ELF's descriptors at anyone's keypoints.

        Parameters
        ----------
        points : (N, 2) array of (x, y) in source-image pixels, or a sequence of cv2.KeyPoint
            A point outside the image takes the descriptor of the nearest place inside.
        descriptor, scale, preset, params : optional
            As in `detect`; of the preset or `params` only its scale matters.

        Returns
        -------
        (N, D) float32, rows of unit L2 norm

        Raises
        ------
        ImageError
            On points of another shape, or NaN or infinite ones.
        SettingError
            If the model has no (such) descriptor, or on a scale or preset that `detect` refuses.
        """
        spec = self.contract.descriptor(descriptor)
        if spec is None:
            raise SettingError(f"{self._network.name}: exported with --desc none, it can't describe")
        where = as_points(points)
        working = self._prepare(image, self.params(preset, params=params, scale=scale))
        if len(where) == 0:
            return np.zeros((0, spec.dim), np.float32)
        found = self._network.run([working.pixels], spec, saliency=False)[spec.output][0]
        return DescriptorMap(found, spec, self._network.name).at(working.scaling.to_working(where))

    def warmup(
        self,
        size: tuple[int, int] = (480, 640),
        scale: float | None = None,
        preset: str | None = None,
        params: DetectionParams | None = None,
    ) -> None:
        """Detect once on noise of (height, width) at a working scale, by default the preset's, else the model's.

        The session of this size is open then: `detect` on the first real image pays no first-use costs.

        Raises
        ------
        SettingError
            If `size` is not two positive integers, or on a scale or preset that `detect` refuses.
        ImageError
            If it is below the model's smallest.
        """
        if not (isinstance(size, Sequence) and len(size) == 2 and all(is_int(side) and side > 0 for side in size)):
            raise SettingError(f"a size is (height, width) in pixels, not {size!r}")
        noise = np.random.default_rng(0).integers(0, 256, (*size, 3), np.uint8)
        working = self._prepare(noise, self.params(preset, params=params, scale=scale)).scaling.working
        self._network.expect(working, self.contract.descriptor())
        self.detect(noise, preset=preset, scale=scale, params=params)
