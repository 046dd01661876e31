"""`ElfRuntime`: one .onnx file in, keypoints, scores and descriptors out."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from .contract import DescriptorSpec, ModelContract
from .detection.descriptors import sample
from .detection.grid import passing_by_cell
from .detection.maxima import maxima
from .detection.refine import parabola_peaks
from .detection.threshold import blurred, passing
from .detection.work import Stopwatch, Work, as_points, prepared
from .errors import ElfError, ImageError, SettingError, first_line
from .image import convert as images
from .image.convert import Array, ImageLike
from .model.bundled import read_bundled
from .model.outputs import check_descriptors, check_map, check_saliency
from .model.session import Provider, is_cpu, read_model, resolve_providers
from .model.sessions import Sessions
from .params import DetectionParams, is_int
from .presets import preset
from .results.features import Features


@dataclass(frozen=True, eq=False)
class Trace:
    """A detection with what led to it, at the working size (h, w).

    Attributes
    ----------
    features : Features
    saliency : (h, w) float32
        S(I), as the graph gives it.
    scores : (h, w) float32
        The denoised saliency whose maxima the keypoints are.
    mask : (h, w) bool
        What passed the threshold (and the user's mask).
    seconds : dict
        Time of each stage: read, prepare, session, blur, threshold, nms, descriptors.
    """

    features: Features
    saliency: Array
    scores: Array
    mask: npt.NDArray[np.bool_]
    seconds: dict[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        (h, w), share = self.saliency.shape, float(self.mask.mean()) if self.mask.size else 0.0
        time = f"{1e3 * sum(self.seconds.values()):.1f} ms"
        return f"Trace({self.features!r}, saliency {w}x{h}, {share:.1%} passed, {time})"


class ElfRuntime:
    """Runs an ELF model: saliency graph, threshold, non-maximum suppression, descriptors.

    Parameters
    ----------
    model : path or bytes, optional
        A file that ``elf-export`` or `to_ort` wrote; it is read once, here.  None is the bundled model, which works
        offline: in int8 on ONNX Runtime's CPU provider, `fallback` to it included, in fp32 on others.
    providers : str, (str, options) or sequence of them, optional
        ONNX Runtime execution providers in order of preference, by short ("cuda") or full name.  None is the CPU.
    threads : int, optional
        Threads within an operator.  None is one per physical core.
    spin : bool, optional
        Let idle threads spin within a call only (None), never (False: where other processes want the cores), or between
        calls too (True: a core each).  Never costs some 15 % of the time on two cores.
    fallback : bool
        Where a provider is not installed or does not start: warn and go on with the next (True), or raise.
    sizes : int
        For that many image sizes, the ones used last, a session of their own is kept, and a second one where images
        come in batches too: ONNX Runtime is up to a sixth faster in fp32 when it knows the size.  Opening one takes
        some 20 to 100 ms.  On the CPU, a size gets it at once if it is the first or `warmup` names it, any other when
        it comes again among the last `sizes` sizes; until then its images go through one session of any size, which
        counts as one of the `sizes`, with the same result up to float32's rounding.  0 is that one session only.  A
        model in ORT format has one session for all.
    max_pixels : int, optional
        Larger images are refused, files before they are decoded (see `image.read`): the network takes some 100 bytes
        for each pixel at the default's working scale.  None is no limit.

    Raises
    ------
    ModelError
        The file is missing, empty or no ONNX model.
    ContractError
        It is an ONNX model, but not an ELF model that this version can run.
    ProviderError
        See `fallback`; or `providers`, `threads` or `spin` is of another kind.
    SettingError
        `sizes` is no integer >= 0, or `max_pixels` none >= 1.

    Attributes
    ----------
    contract : ModelContract
        What the model file says of itself.
    providers : list of str
        Names of the active execution providers, the preferred one first.

    Notes
    -----
    An instance is safe to use from several threads at once.  Copied or pickled, for a pool of processes, it opens its
    model again.

    `detect` runs the whole graph; the first call of `saliency` or `describe` opens a session of that part of the graph
    alone.  A model in ORT format can't be cut: there they run the whole graph too.
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
        max_pixels: int | None = images.MAX_PIXELS,
    ) -> None:
        if not is_int(sizes) or sizes < 0:
            raise SettingError(f"sizes is an integer >= 0, not {sizes!r}")
        if max_pixels is not None and (not is_int(max_pixels) or max_pixels < 1):
            raise SettingError(f"max_pixels is None or an integer >= 1, not {max_pixels!r}")
        self._max_pixels = max_pixels
        options = {"providers": providers, "threads": threads, "spin": spin, "fallback": fallback}
        self._given = (None if model is None else read_model(model), options, int(sizes))
        self._open(*self._given)

    def _open(self, given: tuple[bytes, str] | None, options: dict[str, Any], sizes: int) -> None:
        """Open and check the model, (bytes, name), by default the bundled one that suits the provider."""
        providers = resolve_providers(options["providers"], options["fallback"])
        # Integers are for CPUs: other providers would convolve in floats, with roundings in between.
        model, self._name = given or read_bundled("int8" if is_cpu(providers) else "fp32")
        self._sessions = Sessions(model, self._name, {**options, "providers": providers}, sizes)
        self.providers = self._sessions.providers
        if is_cpu(self.providers) and not is_cpu(providers):
            # Installed, but it did not start, and need not be tried again for each size.
            self._open(given, {**options, "providers": None}, sizes)
            return
        self.contract = ModelContract.from_metadata(self._sessions.metadata, self._name)
        self.contract.check_tensors(self._sessions.inputs, self._sessions.outputs, self._name)

    def __getstate__(self) -> dict[str, Any]:
        """What opens the same model again, in any process: its bytes, unless it is the bundled one, and the options."""
        return {"given": self._given, "max_pixels": self._max_pixels}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._given, self._max_pixels = state["given"], state["max_pixels"]
        self._open(*self._given)

    @property
    def sha256(self) -> str:
        """SHA-256 of the model's file."""
        return self._sessions.sha256

    def __repr__(self) -> str:
        c = self.contract
        layers = ",".join(d.layer for d in c.descriptors) or "none"
        return f"ElfRuntime({self._name!r}: {c.network} {c.layer}, descriptors {layers}, {self.providers[0]})"

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
        settings |= {
            "max_keypoints": max_keypoints,
            "threshold": threshold,
            "nms_radius": nms_radius,
            "border": border,
            "scale": scale,
        }
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
        spec = self.contract.descriptor(descriptor)
        watch = Stopwatch()
        work = self._prepare(image, params, mask, watch=watch)
        with watch("session"):
            saliency, maps = self._run(work.pixels[None], [spec] if spec else []) if work.textured else (None, {})
        return self._finish(work, params, spec, saliency[0] if saliency is not None else None, maps, 0, watch)

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
        if masks is not None:
            batch, masks = list(batch), list(masks)
            if len(masks) != len(batch):
                raise ImageError(f"{len(masks)} masks for {len(batch)} images")
        params = self.params(preset, **settings)
        spec = self.contract.descriptor(descriptor)
        results: list[Features] = []
        group: list[Work] = []
        most = self.contract.input.batch or batch_size

        def flush() -> None:
            textured = [work for work in group if work.textured]
            if textured:
                saliency, maps = self._run(np.stack([w.pixels for w in textured]), [spec] if spec else [])
            index = 0
            for work in group:
                found = saliency[index] if work.textured else None
                traced = self._finish(work, params, spec, found, maps if work.textured else {}, index, Stopwatch())
                results.append(traced.features)
                index += work.textured
            group.clear()

        for i, item in enumerate(batch):
            mask = masks[i] if masks is not None else None
            work = self._prepare(item, params, mask, f"image {i} of the batch")
            if group and (len(group) == most or work.pixels.shape != group[0].pixels.shape):
                flush()
            group.append(work)
        if group:
            flush()
        return results

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
        work = self._prepare(image, self.params(preset, params=params, scale=scale), None)
        if not work.textured:
            return np.zeros(work.size, np.float32)
        found: Array = self._run(work.pixels[None], [])[0][0]
        if found.shape != work.size:
            height, width = work.size
            found = np.asarray(cv2.resize(found, (width, height), interpolation=cv2.INTER_LINEAR))
        return found

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
            raise SettingError(f"{self._name}: exported with --desc none, it can't describe")
        where = as_points(points)
        work = self._prepare(image, self.params(preset, params=params, scale=scale), None)
        if len(where) == 0:
            return np.zeros((0, spec.dim), np.float32)
        maps = self._run(work.pixels[None], [spec], saliency=False)[1]
        return self._described(maps[spec.output][0], work.to_working(where), spec)

    def _described(self, feature_map: Array, points: Array, spec: DescriptorSpec) -> Array:
        with np.errstate(invalid="ignore", over="ignore"):  # an error of its own follows
            rows = sample(feature_map, points, spec.stride, spec.offset)
        check_descriptors(rows, feature_map, spec, self._name)
        return rows

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
        spec = self.contract.descriptor()
        pixels = self._prepare(noise, self.params(preset, params=params, scale=scale), None).pixels
        self._sessions.get(self._outputs([spec] if spec else []), (1, *pixels.shape[:2]), expected=True)
        self.detect(noise, preset=preset, scale=scale, params=params)

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
        mask: npt.ArrayLike | None,
        place: str = "",
        watch: Stopwatch | None = None,
    ) -> Work:
        watch = watch or Stopwatch()
        with watch("read"):
            array = images.read(image, max_pixels=self._max_pixels)
        with watch("prepare"), images.named(image, place):
            images.check_pixels(array.shape, self._max_pixels)
            return prepared(array, params, mask, self.contract, self._name)

    def _outputs(self, specs: Sequence[DescriptorSpec], saliency: bool = True) -> list[str]:
        return ([self.contract.saliency_output] if saliency else []) + [spec.output for spec in specs]

    def _run(
        self, pixels: Array, specs: Sequence[DescriptorSpec], saliency: bool = True
    ) -> tuple[Array, Mapping[str, Array]]:
        names = self._outputs(specs, saliency)
        session, options = self._sessions.get(names, pixels.shape[:3])
        try:
            values = session.run(names, {self.contract.input.name: pixels}, options)
        except Exception as error:  # onnxruntime's own exceptions share no base of theirs
            reason = first_line(error)
            raise ElfError(f"{self._name}: the network failed on a {pixels.shape} input: {reason}") from error
        by_name = dict(zip(names, values, strict=True))
        shape = (pixels.shape[0], pixels.shape[1], pixels.shape[2])
        if saliency:
            check_saliency(by_name[self.contract.saliency_output], shape, self._name)
        for spec in specs:
            check_map(by_name[spec.output], spec, shape, self._name)
        return by_name.get(self.contract.saliency_output, np.zeros((len(pixels), 0, 0), np.float32)), by_name

    def _finish(
        self,
        work: Work,
        params: DetectionParams,
        spec: DescriptorSpec | None,
        saliency: Array | None,
        maps: Mapping[str, Array],
        index: int,
        watch: Stopwatch,
    ) -> Trace:
        dim = spec.dim if spec else 0
        if saliency is None:
            zero = np.zeros(work.pixels.shape[:2], np.float32)
            nothing = Features(
                np.zeros((0, 2), np.float32), np.zeros(0, np.float32), np.zeros((0, dim), np.float32),
                work.size, params.nms_radius,
            )  # fmt: skip
            return Trace(nothing, zero, zero, np.zeros(zero.shape, np.bool_), watch.seconds)
        with watch("blur"):
            allowed = work.allowed()
            scores, smooth = blurred(saliency, params, allowed)
        with watch("threshold"):
            if params.grid == (1, 1):
                mask = passing(scores, smooth, params, allowed)
            else:
                mask = passing_by_cell(saliency, params, allowed)
        with watch("nms"):
            found, strength = maxima(scores, mask, work, params)
            # The paper's scores were of 8 bits so far.
            values, best = scores.astype(np.float32, copy=False), strength.astype(np.float32, copy=False)
        with watch("descriptors"):
            points = found.astype(np.float32)
            if params.subpixel:
                points = work.kept_inside(parabola_peaks(values, found), found, params.border)
            descriptors = np.zeros((len(points), dim), np.float32)
            if spec is not None and len(points):
                descriptors = self._described(maps[spec.output][index], points, spec)
        features = Features(work.to_source(points), best, descriptors, work.size, params.nms_radius)
        return Trace(features, saliency, values, mask, watch.seconds)
