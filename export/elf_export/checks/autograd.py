"""Held against torch.autograd in float64: the check of a network that torch can run, at pixel and keypoint level."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import onnx

from elf_export.graph.image_input import ImageInput
from elf_export.graph.sizes import Sizes
from elf_export.preprocessing import Preprocessing
from elf_export.saliency import SALIENCY
from elf_runtime import DetectionParams
from elf_runtime.detection.nms import greedy_nms
from elf_runtime.detection.threshold import scores_and_mask
from elf_runtime.model.session import open_session

from .forward import ForwardMaps
from .pictures import probe_images
from .torch_reference import Reference, torch_maps, torch_saliency

if TYPE_CHECKING:
    import torch

Array = npt.NDArray[np.float32]
Array64 = npt.NDArray[np.float64]

SIZES = ((176, 240), (177, 239))  # (height, width) of the pictures

# Where a ReLU or a pooling window switches between float32 and float64, S differs over that unit's receptive
# field (torch's own float32 switches as often); everywhere else it agrees to float32's rounding, about 3e-7.
# All errors are fractions of max S.
ROUNDING = 1e-4
MEDIAN = 1e-5  # half of the pixels are off by less: a wrong factor anywhere in the graph is seen here
MOST = 1e-2  # 99 % of the pixels are off by less
KEYPOINTS = 0.99  # of all images' keypoints are identical; one may always differ


@dataclass(frozen=True)
class MapError:
    """How far a saliency map is off, in fractions of the reference's maximum.

    Attributes
    ----------
    median, most, largest : the 50th, 99th and 100th percentile over the pixels
    share : of the pixels off by more than 1e-4
    """

    median: float
    most: float
    largest: float
    share: float


@dataclass(frozen=True)
class PictureCheck:
    """Agreement on one picture.

    Attributes
    ----------
    agreeing : share of the reference's keypoints that the graph finds at the same pixel
    attainable : the share that the reference itself finds when it computes in float32, 1 where not asked
    """

    picture: str
    size: str
    error: MapError
    keypoints: int
    agreeing: float
    attainable: float = 1.0

    @property
    def close(self) -> bool:
        return self.error.median <= MEDIAN and self.error.most <= MOST


@dataclass(frozen=True)
class AutogradCheck:
    """The saliency map beside torch.autograd's, on every picture."""

    pictures: tuple[PictureCheck, ...]

    @property
    def passed(self) -> bool:
        """Every map is close, and nearly all keypoints of all pictures together, of those attainable, are the same."""
        count = sum(p.keypoints * p.attainable for p in self.pictures)
        same = sum(p.keypoints * min(p.agreeing, p.attainable) for p in self.pictures)
        return all(p.close for p in self.pictures) and same >= min(KEYPOINTS * count, count - 1)

    @property
    def complaint(self) -> str:
        return (
            f"the graph disagrees with its reference. Wanted are a median error of at most {MEDIAN:g} of max S, 99 % "
            f"of the pixels within {MOST:g}, and {KEYPOINTS:.0%} of the keypoints the same."
        )

    def table(self) -> str:
        rows = ["error of S / max S in float32   median      99 %   largest   > 1e-4   keypoints  the same"]
        for p in self.pictures:
            e = p.error
            rows.append(
                f"{p.picture:<18}{p.size:>12} {e.median:>9.1e} {e.most:>9.1e} {e.largest:>9.1e} {e.share:>8.2%}"
                f" {p.keypoints:>11} {p.agreeing:>9.1%}"
            )
        return "\n".join(rows)

    def figures(self) -> dict[str, float]:
        """The worst error of all pictures, and the share of all keypoints that agree."""
        same = sum(p.keypoints * p.agreeing for p in self.pictures)
        return {
            "median_error": max(p.error.median for p in self.pictures),
            "max_error": max(p.error.largest for p in self.pictures),
            "share_above_1e-4": max(p.error.share for p in self.pictures),
            "keypoint_agreement": same / max(sum(p.keypoints for p in self.pictures), 1),
        }


@dataclass(frozen=True)
class Autograd:
    """The oracle of a network that torch can run.

    Attributes
    ----------
    module : torch.nn.Module
        Its forward returns the maps of `layers`, F first.
    differentiate : bool
        False: F itself is the saliency map.
    """

    module: torch.nn.Module
    layers: tuple[str, ...]
    preprocessing: Preprocessing
    differentiate: bool = True

    def check(self, model: onnx.ModelProto, color: str, params: DetectionParams, sizes: Sizes) -> AutogradCheck:
        """Hold a saliency graph, whose image is of colour order `color`, against the module; it takes any size."""
        del sizes
        exactly, single = (
            torch_saliency(copy.deepcopy(self.module), self.preprocessing, dtype, self.differentiate, color)
            for dtype in ("float64", "float32")
        )
        return compare_on_pictures(model, exactly, 1 if color == "gray" else 3, params, single)

    def maps(self, _: onnx.ModelProto, layers: Sequence[str], color: str) -> Callable[[Array], Mapping[str, Array64]]:
        """The maps of `layers`, channels last, for raw pixels of colour order `color`."""
        maps = torch_maps(copy.deepcopy(self.module), self.layers, self.preprocessing, color)

        def of_layers(pixels: Array) -> dict[str, Array64]:
            found = maps(pixels)
            return {layer: found[layer] for layer in layers}

        return of_layers

    def averaging(self, _: onnx.ModelProto) -> Autograd:
        """The oracle of the same network with average-pooling in place of max-pooling."""
        from .averaging import Averaging

        return replace(self, module=Averaging(self.module))

    def describing(self, forward: onnx.ModelProto, image: ImageInput) -> ForwardMaps:
        """The maps of `forward`, as torch knows the whole network only."""
        return ForwardMaps(forward, image, self.preprocessing)


def compare_on_pictures(
    model: onnx.ModelProto,
    reference: Reference,
    channels: int,
    params: DetectionParams,
    single: Reference | None = None,
) -> AutogradCheck:
    """Compare the model in ONNX Runtime with `reference`: two pictures, two sizes (one odd), as a batch of two.

    Parameters
    ----------
    single : function, optional
        `reference` in float32.  It is asked where too few keypoints agree: large flat areas under a wide first
        convolution and a max-pool (AlexNet's) tie exactly, and then rounding picks keypoints, torch's too.
    """
    session, _ = open_session(model.SerializeToString())
    name = session.get_inputs()[0].name
    checks: list[PictureCheck] = []
    for height, width in SIZES:
        pictures = probe_images(height, width, channels)
        batch = np.stack([picture for _, picture in pictures])
        found = session.run([SALIENCY], {name: batch})[0]
        wanted = reference(batch)
        here = [
            _compare(label, one, other, params) for (label, _), one, other in zip(pictures, found, wanted, strict=True)
        ]
        if single is not None and not AutogradCheck((*checks, *here)).passed:
            here = [
                replace(c, attainable=keypoint_agreement(one.astype(np.float32), other, params)[1])
                for c, one, other in zip(here, single(batch), wanted, strict=True)
            ]
        checks += here
    return AutogradCheck(tuple(checks))


def compare(found: Array, wanted: Array64) -> MapError:
    """The error of one map, (H, W) against (H, W)."""
    top = max(float(wanted.max()), np.finfo(np.float32).tiny)
    error = np.abs(found.astype(np.float64) - wanted) / top
    if not np.isfinite(error).all():
        return MapError(np.inf, np.inf, np.inf, 1.0)
    median, most, largest = (float(v) for v in np.percentile(error, (50, 99, 100)))
    return MapError(median, most, largest, float((error > ROUNDING).mean()))


def keypoint_agreement(found: Array, wanted: Array64, params: DetectionParams) -> tuple[int, float]:
    """(keypoints of the reference, share of them that `found` has at the same pixel)."""
    mine, theirs = (_keypoints(s, params) for s in (found, wanted.astype(np.float32)))
    most = max(len(mine), len(theirs))
    return len(theirs), len(mine & theirs) / most if most else 1.0


def _compare(label: str, found: Array, wanted: Array64, params: DetectionParams) -> PictureCheck:
    count, agreeing = keypoint_agreement(found, wanted, params)
    return PictureCheck(label, f"{found.shape[1]}x{found.shape[0]}", compare(found, wanted), count, agreeing)


def _keypoints(saliency: Array, params: DetectionParams) -> set[tuple[int, int]]:
    scores, mask = scores_and_mask(saliency, params)
    points, _ = greedy_nms(scores, mask, params.nms_radius, params.max_keypoints)
    return {(int(x), int(y)) for x, y in points}
