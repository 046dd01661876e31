"""What a lower precision changes: the model against its float32 self, down to keypoints and matches."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial

import cv2
import numpy as np
import numpy.typing as npt

from elf_export.calibration import CalibrationSet
from elf_export.errors import VerificationError
from elf_runtime import ElfRuntime, Features, ModelError
from elf_runtime.checks.repeatability import covisible, repeatability_and_matching_score

from .views import sources, view_of

NEAR = 1.0  # pixels of the source image
REPEATED = 5.0  # the paper's
NO_GAIN = 0.97  # of float32's time
LEAST_CORRELATION = 0.5  # below it, the low precision has lost the saliency


@dataclass(frozen=True)
class PrecisionCheck:
    """A model of lower precision beside its float32 self, over the calibration images that are not flat.

    Attributes
    ----------
    precision : the lower one
    correlation : of the saliency maps' values, mean over the images
    agreeing : share of float32's keypoints that have one within a pixel
    keypoints, keypoints_fp32 : mean numbers
    rep, ms, rep_fp32, ms_fp32 : in percent; repeatability and matching score between each image and a view of it
        under a homography, another light and noise.  ms is None without descriptors.
    time : of the network on this machine's CPU, as a share of float32's; median over the views
    """

    precision: str
    correlation: float
    agreeing: float
    keypoints: float
    keypoints_fp32: float
    rep: float
    rep_fp32: float
    ms: float | None
    ms_fp32: float | None
    time: float

    @property
    def passed(self) -> bool:
        return self.correlation >= LEAST_CORRELATION

    @property
    def complaint(self) -> str:
        return (
            f"{self.precision} loses the saliency of this network: its correlation with float32's is "
            f"{self.correlation:.3f}, at least {LEAST_CORRELATION:g} is wanted."
        )

    def figures(self) -> dict[str, float]:
        """What another machine would find too."""
        left_out = ("precision", "time")
        found = {name: value for name, value in asdict(self).items() if value is not None and name not in left_out}
        return {f"lower_{name}": value for name, value in found.items()}

    def table(self) -> str:
        def row(
            name: str, correlation: str, agreeing: str, keypoints: float, rep: float, ms: float | None, time: str
        ) -> str:
            score = "-" if ms is None else f"{ms:.1f}"
            return f"{name:<8}{correlation:>12}{agreeing:>13}{keypoints:>11.0f}{rep:>7.1f}{score:>9}{time:>7}"

        lines = [
            f"{'':8}{'correlation':>12}{'kpts < 1 px':>13}{'keypoints':>11}{'rep %':>7}{'match %':>9}{'time':>7}"
            "   (images, views of them; time on this CPU)",
            row("fp32", "1", "100%", self.keypoints_fp32, self.rep_fp32, self.ms_fp32, "1"),
            row(
                self.precision, f"{self.correlation:.4f}", f"{self.agreeing:.1%}", self.keypoints, self.rep, self.ms,
                f"{self.time:.2f}",
            ),
        ]  # fmt: skip
        if self.precision == "int8" and self.time > NO_GAIN:
            lines.append("int8 is no faster here: most of this network's time is not in convolutions. Use fp32.")
        return "\n".join(lines)


def measure(lower: bytes, full: bytes, images: CalibrationSet) -> PrecisionCheck:
    """Run both models, with their contracts, on every image and on a view of it; flat images say nothing.

    Raises
    ------
    ExportError
        If a file can't be read as an image any more.
    VerificationError
        If the lower precision gives no finite saliency, or float32 finds none.
    """
    a, b = ElfRuntime(lower), ElfRuntime(full)
    rows, times = [], []
    for index, image in enumerate(sources(images, b.contract.input, b.contract.detection.working_scales[0])):
        view, homography = view_of(image, index)
        other = b.trace(image)
        if np.ptp(other.saliency) == 0:
            continue
        try:
            one = a.trace(image)
            finite = bool(np.isfinite(one.saliency).all())
        except ModelError:  # the runtime refuses maps that are not
            finite = False
        if not finite:
            raise VerificationError(
                f"{a.contract.precision} overflows in this network: its saliency is not finite. No file was written."
            )
        varies = one.saliency.std() > 0
        correlation = float(np.corrcoef(one.saliency.ravel(), other.saliency.ravel())[0, 1]) if varies else 0.0
        near = _near(other.features.keypoints, one.features.keypoints)
        # The second images of their size: no session is opened.
        seen, also = a.trace(view), b.trace(view)
        times.append(seen.seconds["session"] / also.seconds["session"])
        scores = [_scores(t.features, v.features, homography) for t, v in ((one, seen), (other, also))]
        rows.append([correlation, near, len(one.features), len(other.features), scores[0][0], scores[1][0],
                     scores[0][1], scores[1][1]])  # fmt: skip
    if not rows:
        raise VerificationError(
            f"{images.name}: float32 finds no saliency in any, so {a.contract.precision} can't be held against it. "
            "No file was written."
        )
    means = np.array(rows, np.float64).mean(axis=0)
    described = bool(a.contract.descriptors)
    correlation, near, count, count_fp32, rep, rep_fp32, ms, ms_fp32 = map(float, means)
    return PrecisionCheck(
        a.contract.precision, correlation, near, count, count_fp32, rep, rep_fp32, ms if described else None,
        ms_fp32 if described else None, float(np.median(times)),
    )  # fmt: skip


def _scores(first: Features, second: Features, homography: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Repeatability and matching score, in percent; 0 where nothing is seen in both."""
    there, back = (partial(_warped, matrix) for matrix in (homography, np.linalg.inv(homography)))
    seen = covisible(first.keypoints, second.keypoints, there, back, _size(first), _size(second))
    distance = None
    if first.descriptors.shape[1]:
        one, other = first.descriptors.astype(np.float64), second.descriptors.astype(np.float64)
        distance = -(one[seen.first] @ other[seen.second].T)  # of unit length: in the order of their distances
    rep, ms, _ = repeatability_and_matching_score(seen, distance, REPEATED)
    return 100 * rep, 100 * (ms or 0.0)


def _warped(homography: npt.NDArray[np.floating], points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.asarray(cv2.perspectiveTransform(points[:, None], homography)[:, 0] if len(points) else points)


def _size(features: Features) -> tuple[int, int]:
    height, width = features.image_size
    return width, height


def _near(points: npt.NDArray[np.float32], others: npt.NDArray[np.float32]) -> float:
    """Share of the points that have one of the others within a pixel."""
    if len(points) == 0:
        return 1.0
    if len(others) == 0:
        return 0.0
    distance = np.linalg.norm(points[:, None] - others[None], axis=2)
    return float((distance.min(axis=1) <= NEAR).mean())
