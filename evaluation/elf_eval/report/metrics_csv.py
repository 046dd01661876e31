"""All figures of a run, for other programs: ``tables.csv``."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

from elf_eval.metrics.epipolar import EPIPOLAR_ERROR
from elf_eval.metrics.homography import HOMOGRAPHY_THRESHOLDS
from elf_eval.metrics.pose import POSE_THRESHOLDS
from elf_eval.run.averages import having, median_error, metrics_in, summarize
from elf_eval.run.results import PairResult, Results

from .columns import superglue


def write_csv(results: Results, path: Path) -> None:
    """Every metric of every method on every dataset, in a row each.

    A row has the mean over scenes, its 95 % interval, and the numbers of pairs and scenes.  Two are over all pairs
    together and have no interval: the AUC as SuperGlue's authors compute it, and ``epi_median``, the median over pairs,
    which is ``inf`` where half of them or more have no right match.
    """
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["dataset", "counts", "method", "metric", "mean", "low", "high", "pairs", "scenes"])
        for dataset in results.datasets:
            for counts in results.protocol["counts"]:
                for method in results.methods:
                    _write_rows(writer, results.of(dataset["name"], method["name"], counts))


def _write_rows(writer: Any, pairs: list[PairResult]) -> None:
    def row(metric: str, over: list[PairResult], *figures: float) -> None:
        where = [over[0].dataset, over[0].counts, over[0].method]
        numbers = [f"{v:.6g}" if v == v else "" for v in figures]
        writer.writerow([*where, metric, *numbers, len(over), len({p.scene for p in over})])

    for metric in metrics_in(pairs):
        value = summarize(pairs, metric)
        if value is not None:
            row(metric, having(pairs, metric), value.mean, value.low, value.high)
    for error, thresholds in (("h_error", HOMOGRAPHY_THRESHOLDS), ("pose_error", POSE_THRESHOLDS)):
        over = [p for p in pairs if error in p.metrics]
        for metric, auc in (superglue(over, error, thresholds) or {}).items():
            row(metric, over, auc, float("nan"), float("nan"))
    if (median := median_error(pairs, EPIPOLAR_ERROR)) is not None:
        over = [p for p in pairs if EPIPOLAR_ERROR in p.metrics]
        row(EPIPOLAR_ERROR, over, median.value, float("nan"), float("nan"))
