"""The tables: the paper's form, with what is compared today beside it."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

from elf_eval.metrics import Estimate
from elf_eval.metrics.matching import MMA_THRESHOLDS
from elf_eval.results import PairResult, Results
from elf_eval.suite import TableEntry

from .paper import PAPER
from .summary import keypoints, metrics_in, summarize
from .table import Table

# Title and metrics of each column group; a group without any value on a dataset is left out.
_COLUMNS: list[tuple[str, list[str]]] = [
    ("MMA@3", ["mma@3"]),
    ("H AUC@1 / 3 / 5", ["h_auc@1", "h_auc@3", "h_auc@5"]),
    ("pose AUC@5 / 10 / 20", ["pose_auc@5", "pose_auc@10", "pose_auc@20"]),
]
_COUNTS = {"own": "up to {n} keypoints", "equal": "equal counts"}


def selected(results: Results, entry: TableEntry) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """The datasets and methods of a table that the results have, in the entry's order."""
    datasets = {d["name"]: d for d in results.datasets}
    methods = {m["name"]: m for m in results.methods}
    chosen_datasets = [datasets[n] for n in entry.datasets or datasets if n in datasets]
    return chosen_datasets, [methods[n] for n in entry.methods or methods if n in methods]


def build(results: Results, entry: TableEntry) -> list[Table]:
    """The tables of an entry: one for each dataset and way of counting."""
    datasets, methods = selected(results, entry)
    tables = []
    for dataset in datasets:
        for counts in results.protocol["counts"]:
            label = _COUNTS[counts].format(n=results.protocol["max_keypoints"])
            caption = f"{dataset['name']}, {label} ({dataset['pairs']} pairs, {dataset['scenes']} scenes)"
            if entry.plot == "mma":
                tables.append(_by_threshold(results, dataset["name"], methods, counts, caption))
                continue
            tables.append(_main(results, dataset["name"], methods, counts, caption))
            if dataset["parameter"]:
                tables.append(_by_parameter(results, dataset, methods, counts, caption))
    return tables


def _main(results: Results, dataset: str, methods: list[dict[str, Any]], counts: str, caption: str) -> Table:
    found = {m["name"]: results.of(dataset, m["name"], counts) for m in methods}
    present = {name for pairs in found.values() for name in metrics_in(pairs)}
    columns = [(title, names) for title, names in _COLUMNS if names[0] in present]
    beside = [m["name"] for m in methods if m["paper"] in PAPER]
    has_place = "rep" in present
    header = ["method", "keypoints (least)"] + (["rep", "ms"] if has_place else [])
    header += [title for title, _ in columns] + ["inliers"]
    header += ["the paper's HPatches", "the paper's Webcam"] if beside else []
    rows = []
    for method in methods:
        pairs = found[method["name"]]
        count = keypoints(pairs)
        row = [method["name"], f"{count.mean:.0f} ({count.least})"]
        row += [_percent(summarize(pairs, name)) for name in ("rep", "ms")] if has_place else []
        row += [" / ".join(_short(summarize(pairs, name)) for name in names) for _, names in columns]
        inliers = summarize(pairs, "h_inliers") or summarize(pairs, "pose_inliers")
        row.append("-" if inliers is None else f"{inliers.mean:.0f}")
        if beside:
            row += [_paper(method["paper"], name) for name in ("HPatches", "Webcam")]
        rows.append(row)
    return Table(caption, header, rows)


def _by_parameter(
    results: Results, dataset: dict[str, Any], methods: list[dict[str, Any]], counts: str, caption: str
) -> Table:
    rows = []
    values: list[float] = []
    for method in methods:
        pairs = results.of(dataset["name"], method["name"], counts)
        values = sorted({p.parameter for p in pairs if p.parameter is not None})
        row = [method["name"]]
        for value in values:
            there = [p for p in pairs if p.parameter == value]
            row.append(f"{_short(summarize(there, 'rep'))} / {_short(summarize(there, 'ms'))}")
        rows.append(row)
    title = f"{caption}: rep / ms by {dataset['parameter']}"
    return Table(title, ["method", *(f"{value:g}" for value in values)], rows)


def _by_threshold(
    results: Results, dataset: str, methods: list[dict[str, Any]], counts: str, caption: str
) -> Table:
    rows = []
    for method in methods:
        pairs = results.of(dataset, method["name"], counts)
        values = [_short(summarize(pairs, f"mma@{t}")) for t in MMA_THRESHOLDS]
        rows.append([method["name"], f"{keypoints(pairs).mean:.0f}", *values])
    header = ["method", "keypoints", *(f"{t} px" for t in MMA_THRESHOLDS)]
    return Table(f"{caption}: share of the matches within", header, rows)


def write_csv(results: Results, path: Path) -> None:
    """Every metric of every method on every dataset: mean over scenes and its 95 % interval."""
    with open(path, "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["dataset", "counts", "method", "metric", "mean", "low", "high", "pairs"])
        for dataset in results.datasets:
            for counts in results.protocol["counts"]:
                for method in results.methods:
                    _csv_rows(writer, results.of(dataset["name"], method["name"], counts))


def _csv_rows(writer: Any, pairs: list[PairResult]) -> None:
    for metric in metrics_in(pairs):
        value = summarize(pairs, metric)
        if value is not None:
            figures = [f"{v:.6g}" for v in (value.mean, value.low, value.high)]
            writer.writerow(
                [pairs[0].dataset, pairs[0].counts, pairs[0].method, metric, *figures, len(pairs)]
            )


def _percent(value: Estimate | None) -> str:
    if value is None:
        return "-"
    if value.low != value.low:  # NaN: a single scene has no interval
        return f"{100 * value.mean:.1f}"
    return f"{100 * value.mean:.1f} [{100 * value.low:.0f}, {100 * value.high:.0f}]"


def _short(value: Estimate | None) -> str:
    return "-" if value is None else f"{100 * value.mean:.1f}"


def _paper(name: str | None, dataset: str) -> str:
    if name is None or name not in PAPER:
        return ""
    rep, ms = PAPER[name][dataset]
    return f"{rep:.1f} / {ms:.1f}"
