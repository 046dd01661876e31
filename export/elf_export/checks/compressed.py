"""What compression changes: the model against the whole network's, down to keypoints, matches and their places."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import cv2
import numpy as np
import numpy.typing as npt

from elf_export.calibration import CalibrationSet
from elf_runtime import ElfRuntime, match

from .lower_precision import LEAST_CORRELATION, PrecisionCheck, measure
from .views import sources, view_of

CLOSE = 1.0  # pixels of the source image, of a match from the truth


@dataclass(frozen=True)
class CompressionCheck:
    """A compressed model beside the whole one, both in float32, over the calibration images that are not flat.

    Attributes
    ----------
    agreement : PrecisionCheck
        The figures that a lower precision is held by; `fp32` there is the whole model.
    mma, mma_whole : float, optional
        Share of the matches between each image and its view within a pixel of the truth, in percent.  None without
        descriptors.
    """

    agreement: PrecisionCheck
    mma: float | None
    mma_whole: float | None

    @property
    def passed(self) -> bool:
        return self.agreement.passed

    @property
    def complaint(self) -> str:
        return (
            "so few multiply-adds lose the saliency of this network: its correlation with the whole one's is "
            f"{self.agreement.correlation:.3f}, at least {LEAST_CORRELATION:g} is wanted. Compress it less."
        )

    def figures(self) -> dict[str, float]:
        """What another machine would find too."""
        values = asdict(self.agreement) | {"mma@1": self.mma, "mma@1_fp32": self.mma_whole}
        kept = {key: v for key, v in values.items() if v is not None and key not in ("precision", "time")}
        return {f"compressed_{name.replace('fp32', 'whole')}": value for name, value in kept.items()}

    def table(self) -> str:
        a = self.agreement
        rows = [
            f"{'':11}{'correlation':>12}{'kpts < 1 px':>13}{'keypoints':>11}{'rep %':>7}{'match %':>9}{'MMA@1 %':>9}"
            f"{'time':>7}   (images, views of them; time on this CPU)",
            _row("whole", "1", "100%", a.keypoints_fp32, a.rep_fp32, a.ms_fp32, self.mma_whole, "1"),
            _row(
                "compressed", f"{a.correlation:.4f}", f"{a.agreeing:.1%}", a.keypoints, a.rep, a.ms, self.mma,
                f"{a.time:.2f}",
            ),
        ]  # fmt: skip
        return "\n".join(rows)


def _row(name: str, correlation: str, agreeing: str, keypoints: float, rep: float, *others: float | str | None) -> str:
    *scores, time = ("-" if v is None else v if isinstance(v, str) else f"{v:.1f}" for v in others)
    cells = "".join(f"{score:>9}" for score in scores)
    return f"{name:<11}{correlation:>12}{agreeing:>13}{keypoints:>11.0f}{rep:>7.1f}{cells}{time:>7}"


def compare_compressed(compressed: bytes, whole: bytes, images: CalibrationSet) -> CompressionCheck:
    """Run both models, with their contracts, on every image and on a view of it.

    Raises
    ------
    ExportError
        If a file can't be read as an image any more.
    VerificationError
        If the compressed network gives no finite saliency, or the whole one finds none.
    """
    agreement = measure(compressed, whole, images)
    if agreement.ms is None:
        return CompressionCheck(agreement, None, None)
    one, other = (_matching_accuracy(ElfRuntime(model), images) for model in (compressed, whole))
    return CompressionCheck(agreement, one, other)


def _matching_accuracy(elf: ElfRuntime, images: CalibrationSet) -> float:
    """MMA@1 in percent: over all pairs with a match, mean of the share that is `CLOSE` to the truth."""
    shares = []
    for index, image in enumerate(sources(images, elf.contract.input, elf.contract.detection.working_scales[0])):
        view, homography = view_of(image, index)
        first, second = elf.detect(image), elf.detect(view)
        pairs = match(first, second)
        if len(pairs):
            shares.append(_close(first.keypoints[pairs[:, 0]], second.keypoints[pairs[:, 1]], homography))
    return 100 * float(np.mean(shares)) if shares else 0.0


def _close(
    points: npt.NDArray[np.floating], others: npt.NDArray[np.floating], homography: npt.NDArray[np.floating]
) -> float:
    there = cv2.perspectiveTransform(np.asarray(points, np.float64)[:, None], homography)[:, 0]
    return float((np.linalg.norm(there - others, axis=1) <= CLOSE).mean())
