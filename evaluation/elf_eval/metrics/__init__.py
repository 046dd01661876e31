"""The metrics, each a function of arrays: no files, no images, no methods."""

from __future__ import annotations

from elf_runtime.checks.greedy import greedy_matching
from elf_runtime.checks.repeatability import Covisible, covisible, repeatability_and_matching_score

from .homography import corner_error, estimate_homography
from .matching import descriptor_distances, mean_matching_accuracy, mutual_nearest
from .pose import estimate_pose, pose_error
from .statistics import Estimate, auc, auc_trapezoids, mean_interval, paired_difference

__all__ = [
    "Covisible",
    "Estimate",
    "auc",
    "auc_trapezoids",
    "corner_error",
    "covisible",
    "descriptor_distances",
    "estimate_homography",
    "estimate_pose",
    "greedy_matching",
    "mean_interval",
    "mean_matching_accuracy",
    "mutual_nearest",
    "paired_difference",
    "pose_error",
    "repeatability_and_matching_score",
]
