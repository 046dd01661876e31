"""tables.csv."""

from __future__ import annotations

import csv

import pytest
from made_results import results

from elf_eval.metrics.auc import auc_trapezoids
from elf_eval.report.metrics_csv import write_csv


def test_the_csv_counts_the_pairs_and_scenes_of_each_metric(some_with_depth, tmp_path):
    write_csv(results(some_with_depth), tmp_path / "t.csv")
    lines = (tmp_path / "t.csv").read_text().splitlines()
    rows = {row["metric"]: row for row in csv.DictReader(lines)}
    assert (rows["rep"]["pairs"], rows["rep"]["scenes"]) == ("2", "1")
    assert (rows["pose_auc@5"]["pairs"], rows["pose_auc@5"]["scenes"]) == ("8", "3")
    assert (rows["rep"]["low"], rows["pose_auc_superglue@5"]["low"]) == ("", "")
    assert float(rows["pose_auc_superglue@5"]["mean"]) == pytest.approx(auc_trapezoids([3.0] * 8, 5))
