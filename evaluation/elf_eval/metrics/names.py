"""Which metrics there are, to refuse a name before the work that would find nothing under it."""

from __future__ import annotations

from collections.abc import Collection

from elf_eval.data.truth import Truth
from elf_eval.errors import EvalError

from .homography import HOMOGRAPHY_THRESHOLDS
from .matching import MMA_THRESHOLDS
from .pose import POSE_THRESHOLDS

_ERRORS = ("h_error", "pose_error")


def names(truth: Truth) -> list[str]:
    """The metrics that can be averaged over pairs of such ground truth, where the method has descriptors."""
    known, found = truth.known(), ["n1", "n2"]
    if "place" in known:
        found += ["seen1", "seen2", "rep", "ms"]
    found.append("matches")
    if "place" in known:
        found += [f"mma@{t}" for t in MMA_THRESHOLDS]
    if "homography" in known:
        found += ["h_inliers", *(f"h_auc@{t}" for t in HOMOGRAPHY_THRESHOLDS)]
    if "pose" in known:
        found += ["pose_inliers", *(f"pose_auc@{t}" for t in POSE_THRESHOLDS)]
    return found


def check(asked: Collection[str], known: Collection[str], who: str) -> None:
    """Refuse metrics that are not among the `known`, which `who` has.

    Raises
    ------
    EvalError
        Also on an error: those have no value where nothing was found, so that their means would reward failure.
    """
    if errors := [name for name in asked if name in _ERRORS]:
        raise EvalError(f"{errors[0]} can't be averaged, failures have none; take h_auc@... or pose_auc@...")
    if unknown := [repr(name) for name in asked if name not in known]:
        raise EvalError(f"unknown metric {', '.join(unknown)}; {who} {', '.join(known)}")


def is_share(metric: str) -> bool:
    """Whether a metric is a share in [0, 1], of which more is better; the others are counts."""
    return metric in ("rep", "ms") or "@" in metric
