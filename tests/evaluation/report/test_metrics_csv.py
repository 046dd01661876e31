"""tables.csv."""

from __future__ import annotations

import csv

import pytest
from made_results import LINED, pair, results

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


@pytest.mark.parametrize(("second", "median"), [(0.5, "0.375"), (None, "inf")])
def test_the_csv_has_the_median_over_pairs_of_epipolar_distances(second, median, tmp_path):
    pairs = [pair("a", 1, LINED), pair("b", 1, {**LINED, "epi_median": second})]
    write_csv(results(pairs), tmp_path / "t.csv")
    rows = {row["metric"]: row for row in csv.DictReader((tmp_path / "t.csv").read_text().splitlines())}
    assert (rows["epi@1"]["mean"], rows["epi_right@3"]["mean"]) == ("0.6", "8")
    assert list(rows["epi_median"].values())[4:] == [median, "", "", "2", "2"]
