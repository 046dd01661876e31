"""Is the exported graph the saliency?  Held against an independent reference, at pixel and keypoint level."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import onnx

from elf_export.errors import VerificationError
from elf_export.saliency import SALIENCY
from elf_runtime import DetectionParams
from elf_runtime.detection.nms import greedy_nms
from elf_runtime.detection.threshold import scores_and_mask
from elf_runtime.model.session import open_session

Array = npt.NDArray[np.float32]
Array64 = npt.NDArray[np.float64]

Reference = Callable[[Array], Array64]
"""(N, H, W, C) float32 raw pixels -> (N, H, W) float64 saliency."""

# Where a ReLU or a pooling window switches between float32 and float64, S differs over that unit's receptive
# field (torch's own float32 switches as often); everywhere else it agrees to float32's rounding, about 3e-7.
# All errors are fractions of max S.
ROUNDING = 1e-4
MEDIAN = 1e-5  # half of the pixels are off by less: a wrong factor anywhere in the graph is seen here
MOST = 1e-2  # 99 % of the pixels are off by less
KEYPOINTS = 0.99  # of all images' keypoints are identical; one may always differ


@dataclass(frozen=True)
class Error:
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
class Check:
    """Agreement on one image.

    Attributes
    ----------
    agreeing : share of the reference's keypoints that the graph finds at the same pixel
    attainable : the share that the reference itself finds when it computes in float32, 1 where not asked
    """

    image: str
    size: str
    error: Error
    keypoints: int
    agreeing: float
    attainable: float = 1.0

    @property
    def close(self) -> bool:
        return self.error.median <= MEDIAN and self.error.most <= MOST


def verify(
    model: onnx.ModelProto,
    reference: Reference,
    channels: int,
    params: DetectionParams,
    single: Reference | None = None,
) -> list[Check]:
    """Compare the model in ONNX Runtime with `reference`: two images, two sizes (one odd), as a batch of two.

    Parameters
    ----------
    single : function, optional
        `reference` in float32.  It is asked where too few keypoints agree: large flat areas under a wide first
        convolution and a max-pool (AlexNet's) tie exactly, and then rounding picks keypoints, torch's too.

    Returns
    -------
    list of Check
        One per image and size.
    """
    session, _ = open_session(model.SerializeToString())
    name = session.get_inputs()[0].name
    checks = []
    for height, width in ((176, 240), (177, 239)):
        images = probe_images(height, width, channels)
        batch = np.stack([image for _, image in images])
        found = session.run([SALIENCY], {name: batch})[0]
        wanted = reference(batch)
        for (label, _), one, other in zip(images, found, wanted, strict=True):
            checks.append(_compare(label, one, other, params))
        if single is not None and not passed(checks):
            news = zip(checks[-len(images) :], single(batch), wanted, strict=True)
            checks[-len(images) :] = [
                replace(c, attainable=keypoint_agreement(one.astype(np.float32), other, params)[1])
                for c, one, other in news
            ]
    return checks


def passed(checks: Sequence[Check]) -> bool:
    """Every map is close, and nearly all keypoints of all images together, of those attainable, are the same."""
    count = sum(c.keypoints * c.attainable for c in checks)
    same = sum(c.keypoints * min(c.agreeing, c.attainable) for c in checks)
    return all(c.close for c in checks) and same >= min(KEYPOINTS * count, count - 1)


def _same(checks: Sequence[Check]) -> float:
    return sum(c.keypoints * c.agreeing for c in checks)


def require(checks: Sequence[Check]) -> None:
    """Raise VerificationError unless the checks `passed`."""
    if not passed(checks):
        raise VerificationError(
            f"the graph disagrees with its reference:\n{table(checks)}\nWanted are a median error of at most "
            f"{MEDIAN:g} of max S, 99 % of the pixels within {MOST:g}, and {KEYPOINTS:.0%} of the keypoints the "
            "same. No file was written."
        )


def table(checks: Sequence[Check]) -> str:
    """The checks as a small text table."""
    rows = ["error of S / max S in float32   median      99 %   largest   > 1e-4   keypoints  the same"]
    for c in checks:
        e = c.error
        rows.append(
            f"{c.image:<18}{c.size:>12} {e.median:>9.1e} {e.most:>9.1e} {e.largest:>9.1e} {e.share:>8.2%}"
            f" {c.keypoints:>11} {c.agreeing:>9.1%}"
        )
    return "\n".join(rows)


def parity(checks: Sequence[Check]) -> dict[str, float]:
    """The worst error of the checks, and the share of all keypoints that agree: for the contract."""
    return {
        "median_error": max(c.error.median for c in checks),
        "max_error": max(c.error.largest for c in checks),
        "share_above_1e-4": max(c.error.share for c in checks),
        "keypoint_agreement": _same(checks) / max(sum(c.keypoints for c in checks), 1),
    }


def compare(found: Array, wanted: Array64) -> Error:
    """The error of one map, (H, W) against (H, W)."""
    top = max(float(wanted.max()), np.finfo(np.float32).tiny)
    error = np.abs(found.astype(np.float64) - wanted) / top
    if not np.isfinite(error).all():
        return Error(np.inf, np.inf, np.inf, 1.0)
    median, most, largest = (float(v) for v in np.percentile(error, (50, 99, 100)))
    return Error(median, most, largest, float((error > ROUNDING).mean()))


def keypoint_agreement(found: Array, wanted: Array64, params: DetectionParams) -> tuple[int, float]:
    """(keypoints of the reference, share of them that `found` has at the same pixel)."""
    mine, theirs = (_keypoints(s, params) for s in (found, wanted.astype(np.float32)))
    most = max(len(mine), len(theirs))
    return len(theirs), len(mine & theirs) / most if most else 1.0


def _compare(label: str, found: Array, wanted: Array64, params: DetectionParams) -> Check:
    error = compare(found, wanted)
    count, agreeing = keypoint_agreement(found, wanted, params)
    return Check(label, f"{found.shape[1]}x{found.shape[0]}", error, count, agreeing)


def _keypoints(saliency: Array, params: DetectionParams) -> set[tuple[int, int]]:
    scores, mask = scores_and_mask(saliency, params)
    points, _ = greedy_nms(scores, mask, params.nms_radius, params.max_keypoints)
    return {(int(x), int(y)) for x, y in points}


def probe_images(height: int, width: int, channels: int) -> list[tuple[str, Array]]:
    """A cartoon (edges and corners on a fine grain, flat areas with exact ties) and noise.

    The grain keeps straight edges from giving rows of equal scores, where rounding would pick the keypoint.

    Returns
    -------
    list of (name, (height, width, channels) float32 holding integers in 0..255)
    """
    rng = np.random.default_rng(7)
    y, x = np.mgrid[:height, :width]
    cartoon = np.empty((height, width, channels), np.float32)
    cartoon[:] = 90 + 60 * np.sin(x / 37)[..., None] * np.cos(y / 23)[..., None]
    grain = rng.integers(-6, 7, cartoon.shape)
    for index in range(60):
        top, left = rng.integers(0, height - 8), rng.integers(0, width - 8)
        h, w = rng.integers(6, height // 4), rng.integers(6, width // 4)
        cartoon[top : top + h, left : left + w] = rng.integers(6, 250, channels)
        if index % 4 == 0:
            grain[top : top + h, left : left + w] = 0
    noise = rng.integers(0, 256, (height, width, channels))
    cartoon = np.floor(cartoon + grain).clip(0, 255)
    return [("cartoon", cartoon.astype(np.float32)), ("noise", noise.astype(np.float32))]
