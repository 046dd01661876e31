"""`ElfRuntime`: the saliency, keypoints and descriptors of images, by one model."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import Any

import numpy.typing as npt

from elf_runtime.detection.descriptors import Array
from elf_runtime.errors import SettingError
from elf_runtime.image.file import MAX_PIXELS, ImageLike
from elf_runtime.model.providers import Provider
from elf_runtime.params import DetectionParams
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

    def __init__(
        self,
        model: str | os.PathLike[str] | bytes | None = None,
        *,
        providers: Provider | Sequence[Provider] | None = None,
        threads: int | None = None,
        spin: bool | None = None,
        fallback: bool = False,
        sizes: int = 2,
        max_pixels: int | None = MAX_PIXELS,
        color: str = "bgr",
    ) -> None:
        """Open and check a model.

        Parameters
        ----------
        model : path or bytes, optional
            A file that ``elf-export`` or `to_ort` wrote; it is read once, here.  One of ``--end-to-end`` takes
            max_keypoints, threshold and masks, and no other settings; it can't `describe`.  None is the bundled model:
            in int8 on ONNX Runtime's CPU provider, `fallback` to it included, and OpenVINO's CPUs, in fp32 on others.
        providers : str, (str, options) or sequence of them, optional
            ONNX Runtime execution providers in order of preference, by short ("cuda") or full name.  None is the CPU.
        threads : int, optional
            Threads within an operator.  None is one per physical core.
        spin : bool, optional
            Let idle threads spin within a call only (None), never (False: where other processes want the cores), or
            between calls too (True: a core each).  Never costs some 15 % of the time on two cores.
        fallback : bool
            Where a provider is not installed or does not start: warn and go on with the next (True), or raise.
        sizes : int
            For that many image sizes, the ones used last, a session of their own is kept (one for each scale, where
            there are several), and a second one where images come in batches too: ONNX Runtime is up to a sixth faster
            in fp32 when it knows the size.  Until a size has it (the first, one that `warmup` names, or one that comes
            again), its images go through a session of any size, with the same result up to rounding.  0 is that session
            only; so is a model in ORT format.
        max_pixels : int, optional
            Larger images are refused, files before they are decoded (see `image.read`): the network takes some 100
            bytes for each pixel at the default's working scale.  None is no limit.
        color : "bgr" or "rgb"
            The order of the channels in arrays: OpenCV's, or that of most other libraries.  Files need none, nor do
            PIL's images, which are RGB.

        Raises
        ------
        ModelError
            The file is missing, empty or no ONNX model; as ContractError, no ELF model that this version can run.
        ProviderError
            See `fallback`; or `providers`, `threads` or `spin` is of another kind.
        SettingError
            `sizes` is no integer >= 0, `max_pixels` none >= 1, or `color` another.
        """
        options = {"providers": providers, "threads": threads, "spin": spin, "fallback": fallback}
        super().__init__(model, options, sizes, max_pixels, color)

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
            BGR (as OpenCV reads; RGB with ``ElfRuntime(color="rgb")``) or grey, or an object that numpy makes an array
            of, such as an image of PIL's; a fourth channel is alpha, and there are no keypoints where it is 0.  uint8,
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
            "fast", "default" (the model's own settings), "accurate", "multiscale", or the paper's: "paper",
            "paper-webcam", "paper-robust", "paper-components".  Where to start from.  Its scale or scales are not for a
            model of one size only.
        scale : float
            Working scale, in place of a preset's `scales` too: 0.5 lets the network see half the width and height.
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
        """As `detect`, with the saliency, scores and threshold mask of each scale, and the time of each stage."""
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
        params, spec = self.params(preset, **settings), self.contract.descriptor(descriptor)
        return [trace.features for trace in self._batches(batch, masks, params, spec, batch_size)]

    def saliency(
        self,
        image: ImageLike,
        scale: float | None = None,
        preset: str | None = None,
        params: DetectionParams | None = None,
    ) -> Array:
        """The saliency map S(I) = |F^T dF/dI|, averaged over the image's channels.

        `scale`, and `preset` or `params`, whose scale it is otherwise, are those of `detect`; the finest of them.

        Returns
        -------
        (H, W) float32
            At the size of the source image (interpolated where the working scale is not 1); zero for a flat image.
        """
        return self._saliency(image, self.params(preset, params=params, scale=scale))

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
            As in `detect`; of the preset or `params` only its scale matters, and whether it is oriented.  Where it has
            several, a cv2.KeyPoint is described at the one whose keypoints have the size nearest to its own, by ratio
            (see `Features.sizes`), and (x, y) at the finest.  If oriented, a cv2.KeyPoint with an angle is turned by
            that, and one with a size is as large; others by and as what `detect` would give them at the finest.

        Returns
        -------
        (N, D) float32, rows of unit L2 norm

        Raises
        ------
        ImageError, SettingError
            On points of another shape, or NaN or infinite ones; if the model has no (such) descriptor.
        """
        spec = self.contract.descriptor(descriptor)
        if spec is None:
            raise SettingError(f"{self._network.name}: exported with --desc none, it can't describe")
        return self._described(image, points, self.params(preset, params=params, scale=scale), spec)

    def warmup(
        self,
        size: tuple[int, int] = (480, 640),
        scale: float | None = None,
        preset: str | None = None,
        params: DetectionParams | None = None,
    ) -> None:
        """Detect once on noise of (height, width) at a working scale, by default the preset's, else the model's.

        The session of this size, one for each scale, is open then, and that of oriented keypoints' patches: `detect` on
        the first real image pays no first-use costs.

        Raises
        ------
        SettingError, ImageError
            If `size` is not two positive integers, or is below the model's smallest or above `max_pixels`.
        """
        self._warm(size, self.params(preset, params=params, scale=scale))
