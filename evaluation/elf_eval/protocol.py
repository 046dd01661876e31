"""The settings that every method of a run shares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import cv2

from elf_runtime.plain import read_dataclass

from .coordinates import Size
from .errors import EvalError

# The names of cv2's constants.
ESTIMATORS = (
    "RANSAC",
    "LMEDS",
    "RHO",
    "USAC_DEFAULT",
    "USAC_PARALLEL",
    "USAC_FM_8PTS",
    "USAC_FAST",
    "USAC_ACCURATE",
    "USAC_PROSAC",
    "USAC_MAGSAC",
)


@dataclass(frozen=True)
class Ransac:
    """Settings of OpenCV's robust estimation; every result states them.

    Attributes
    ----------
    estimator : str
        One of `ESTIMATORS`.
    threshold : float
        Pixels.
    """

    estimator: str = "USAC_MAGSAC"
    threshold: float = 3.0
    iterations: int = 10000
    confidence: float = 0.9999
    seed: int = 0

    def __post_init__(self) -> None:
        if self.estimator not in ESTIMATORS:
            raise EvalError(f"protocol: estimator is one of {', '.join(ESTIMATORS)}, not {self.estimator!r}")

    @property
    def method(self) -> int:
        value: int = getattr(cv2, self.estimator)
        return value


@dataclass(frozen=True)
class Protocol:
    """How images are prepared and features compared; the defaults are the paper's.

    Attributes
    ----------
    size : (width, height) or None
        Every image is resized to it by a bilinear filter; None leaves images as they are.
    max_keypoints : int
        Of each image, at most this many: the strongest.
    eps : float
        A keypoint is repeated if it is found again within so many pixels.
    counts : tuple of "own" and "equal"
        "own": what the method finds, up to `max_keypoints`.  "equal": of each image, every method keeps as many as
        the method that found the fewest there.
    count_floor : int
        Equal counts are at least this, so that one method which finds next to nothing does not decide for all.  A
        method that finds fewer keeps what it has.
    homography, pose : Ransac
    ratio : float in (0, 1), optional
        Lowe's test: of the mutual nearest neighbours, keep those whose distance is below `ratio` times that to the
        second nearest in image 2.  A method's own (`Method.ratio`) goes before.  For MMA, homographies, poses and
        epipolar distances; the paper's matching score knows none.
    refine : bool
        Move the second points of these matches by `elf_runtime.refine`, which compares the two images.  A method's own
        (`Method.refine`) goes before.  For the same metrics.
    """

    size: Size | None = (640, 480)
    max_keypoints: int = 500
    eps: float = 5.0
    counts: tuple[str, ...] = ("own",)
    count_floor: int = 0
    homography: Ransac = field(default_factory=Ransac)
    pose: Ransac = field(default_factory=lambda: Ransac(estimator="RANSAC", threshold=1.0, iterations=1000))
    ratio: float | None = None
    refine: bool = False

    def __post_init__(self) -> None:
        if self.size is not None and not _is_size(self.size):
            raise _no_size(self.size)
        if self.max_keypoints < 1:
            raise EvalError(f"protocol: max_keypoints is an integer >= 1, not {self.max_keypoints!r}")
        if not isinstance(self.count_floor, int) or not 0 <= self.count_floor <= self.max_keypoints:
            raise EvalError(
                f"protocol: count_floor is a whole number from 0 to max_keypoints, not {self.count_floor!r}"
            )
        if not self.eps > 0:
            raise EvalError(f"protocol: eps is a positive number of pixels, not {self.eps!r}")
        if not self.counts or set(self.counts) - {"own", "equal"}:
            raise EvalError(f"protocol: counts is a list of 'own' and 'equal', not {self.counts!r}")
        if self.ratio is not None:
            try:
                checked_ratio(self.ratio)
            except ValueError as error:
                raise EvalError(f"protocol: {error}") from error

    def to_dict(self) -> dict[str, Any]:
        """Plain data, for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Protocol:
        """From plain data, such as a suite's ``[protocol]``; ``size = "source"`` keeps images as they are.

        Raises
        ------
        EvalError
            On an unknown key, or a value of another kind.
        """
        try:
            if isinstance(data, Mapping) and "size" in data:
                size = None if data["size"] == "source" else data["size"]
                if size is not None and not _is_size(size):
                    raise _no_size(size)
                data = {**data, "size": size}
            return read_dataclass(cls, data)
        except ValueError as error:
            raise EvalError(f"protocol: {error}") from error


def checked_ratio(value: float) -> float:
    """`value`, a ratio of Lowe's test; a ValueError where it is not in (0, 1)."""
    if not 0.0 < value < 1.0:
        raise ValueError(f"ratio is a number in (0, 1), not {value!r}")
    return value


def _is_size(value: Any) -> bool:
    """Whether it is two integers from 1 on; true and false are none."""
    return isinstance(value, (list, tuple)) and len(value) == 2 and all(type(n) is int and n >= 1 for n in value)


def _no_size(value: object) -> EvalError:
    return EvalError(f"protocol: size is [width, height] or 'source', not {value!r}")
