"""All metrics, in the order of every table, and which names they have."""

from __future__ import annotations

from collections.abc import Collection

from elf_eval.data.truth import Truth
from elf_eval.errors import EvalError
from elf_runtime.errors import suggestion

from .epipolar import EPIPOLAR
from .homography import HOMOGRAPHY
from .keypoint_counts import KEYPOINT_COUNTS
from .matching_accuracy import MATCHES, MATCHING_ACCURACY
from .pose import POSE
from .repeatability import REPEATABILITY

FAMILIES = (KEYPOINT_COUNTS, REPEATABILITY, MATCHES, MATCHING_ACCURACY, HOMOGRAPHY, POSE, EPIPOLAR)

SHARES = frozenset(name for family in FAMILIES for name in family.shares)
ERRORS = frozenset(family.error for family in FAMILIES if family.error)


def metric_names(truth: Truth) -> list[str]:
    """The metrics that can be averaged over pairs of such ground truth, for a method with descriptors."""
    defined = [family for family in FAMILIES if family.is_defined(truth.known(), is_described=True)]
    return [name for family in defined for name in (*family.counts, *family.shares)]


def check_metrics(asked: Collection[str], known: Collection[str], who: str) -> None:
    """Refuse metrics that are not among the `known` ones, which `who` has.

    Raises
    ------
    EvalError
        Also for an error, which has no value where nothing was found: its mean would reward failure.
    """
    if errors := [name for name in asked if name in ERRORS]:
        raise EvalError(f"{errors[0]} can't be averaged, failures have none; take h_auc@..., pose_auc@... or epi@...")
    if unknown := [repr(name) for name in asked if name not in known]:
        near = suggestion(unknown[0].strip("'"), known)
        raise EvalError(f"unknown metric {', '.join(unknown)}; {who} {', '.join(known)}{near}")


def is_share(metric: str) -> bool:
    """Whether a metric is a share in [0, 1], of which more is better; the others are counts."""
    return metric in SHARES
