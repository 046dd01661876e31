"""The settings that every method of a run shares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import cv2

from elf_runtime.plain import read_dataclass

from .coordinates import Size
from .errors import EvalError


@dataclass(frozen=True)
class Ransac:
    """Settings of OpenCV's robust estimation; every result states them.

    Attributes
    ----------
    estimator : str
        Name of a cv2 constant, "RANSAC", "USAC_MAGSAC" ...
    threshold : float
        Pixels.
    """

    estimator: str = "USAC_MAGSAC"
    threshold: float = 3.0
    iterations: int = 10000
    confidence: float = 0.9999
    seed: int = 0

    @property
    def method(self) -> int:
        value = getattr(cv2, self.estimator, None)
        if not isinstance(value, int):
            raise EvalError(f"OpenCV {cv2.__version__} has no robust estimator {self.estimator!r}")
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
    """

    size: Size | None = (640, 480)
    max_keypoints: int = 500
    eps: float = 5.0
    counts: tuple[str, ...] = ("own",)
    count_floor: int = 0
    homography: Ransac = field(default_factory=Ransac)
    pose: Ransac = field(default_factory=lambda: Ransac(estimator="RANSAC", threshold=1.0, iterations=1000))

    def __post_init__(self) -> None:
        if self.size is not None and (len(self.size) != 2 or min(self.size) < 1):
            raise EvalError(f"protocol: size is (width, height), not {self.size!r}")
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
        stated = {**data, "size": None} if data.get("size") == "source" else data
        try:
            return read_dataclass(cls, stated)
        except ValueError as error:
            raise EvalError(f"protocol: {error}") from error
