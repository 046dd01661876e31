"""Which results a figure of the paper is for; others are refused, as their bars and curves would mean nothing."""

from __future__ import annotations

from elf_eval.errors import EvalError
from elf_eval.metrics.epipolar import EPIPOLAR
from elf_eval.metrics.homography import HOMOGRAPHY
from elf_eval.metrics.pose import POSE
from elf_eval.run.results import Results
from elf_eval.suite.paper_logs import experiment


def check_generic(results: Results, dataset: str) -> None:
    """Refuse what is not like HPatches or Webcam: EvalError where pairs vary in an angle or scale, or have cameras."""
    about = next(d for d in results.datasets if d["name"] == dataset)
    cameras = "scenes with cameras" if _has(results, dataset, *POSE.shares, *EPIPOLAR.shares) else ""
    kind = experiment(about)
    other = about["parameter"] or cameras if kind == "generic" else kind
    if other:
        figure = "curves" if about["parameter"] else "viewpoint"
        raise EvalError(
            f"{dataset}: this figure is for HPatches, Webcam and their like, not for {other}; "
            f"elf-eval figures {figure} is for those"
        )


def check_viewpoint(results: Results, dataset: str) -> None:
    """Refuse what is not like Strecha's scenes: EvalError where pairs have homographies."""
    about = next(d for d in results.datasets if d["name"] == dataset)
    if about["parameter"] or _has(results, dataset, *HOMOGRAPHY.shares):
        figure = "curves" if about["parameter"] else "bars"
        raise EvalError(
            f"{dataset}: this figure is for scenes with cameras, as Strecha's, not for pairs with homographies; "
            f"elf-eval figures {figure} is for those"
        )


def _has(results: Results, dataset: str, *metrics: str) -> bool:
    return any(metric in p.metrics for p in results.pairs if p.dataset == dataset for metric in metrics)
