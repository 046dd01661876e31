"""The tables: in the paper's form, with what is compared today beside it."""

from __future__ import annotations

from typing import Any

from elf_eval.metrics.matching_accuracy import MMA_THRESHOLDS
from elf_eval.run.averages import having, image_counts, keypoints, summarize
from elf_eval.run.results import PairResult, Results
from elf_eval.suite import paper
from elf_eval.suite.suite import TableEntry

from .columns import by_pairs, short
from .table import Table


def selected(results: Results, entry: TableEntry) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """The datasets and methods of an entry that the results have, in the entry's order."""
    datasets = {d["name"]: d for d in results.datasets}
    methods = {m["name"]: m for m in results.methods}
    chosen_datasets = [datasets[n] for n in entry.datasets or datasets if n in datasets]
    return chosen_datasets, [methods[n] for n in entry.methods or methods if n in methods]


def build(results: Results, entry: TableEntry) -> list[Table]:
    """The tables of an entry: one for each dataset and way of counting.

    Metrics that are over different pairs stand in tables of their own.
    """
    datasets, methods = selected(results, entry)
    tables = []
    for dataset in datasets:
        for counts in results.protocol["counts"]:
            if entry.plot == "mma":
                tables.append(_by_threshold(results, dataset, methods, counts))
                continue
            tables += _main(results, dataset, methods, counts, entry)
            if dataset["parameter"]:
                tables.append(_by_parameter(results, dataset, methods, counts))
    return tables


def how_counted(results: Results, counts: str) -> str:
    """In words: up to how many keypoints, or as many as the method with the fewest."""
    if counts == "own":
        return f"up to {results.protocol['max_keypoints']} keypoints"
    floor = results.protocol.get("count_floor", 0)
    return f"equal counts, at least {floor}" if floor else "equal counts"


def _caption(results: Results, dataset: dict[str, Any], counts: str, found: list[list[PairResult]]) -> str:
    """The dataset, how many keypoints are kept, and over how many pairs and scenes a table is."""
    there = {(p.scene, p.pair) for pairs in found for p in pairs}
    sizes = (len(there), dataset["pairs"], "pair"), (len({scene for scene, _ in there}), dataset["scenes"], "scene")
    parts = ", ".join(f"{n if n == of else f'{n} of {of}'} {what}{'' if of == 1 else 's'}" for n, of, what in sizes)
    text = f"{dataset['name']}, {how_counted(results, counts)} ({parts})"
    floor = results.protocol.get("count_floor", 0)
    if counts == "equal" and floor:
        images = [item for pairs in found for item in image_counts(pairs).items()]
        fewer = {name for name, count in images if count < floor}
        text += f"; on {len(fewer)} of {len(dict(images))} images a method finds fewer than {floor}"
    return text


def _main(
    results: Results, dataset: dict[str, Any], methods: list[dict[str, Any]], counts: str, entry: TableEntry
) -> list[Table]:
    found = {m["name"]: results.of(dataset["name"], m["name"], counts) for m in methods}
    tables = []
    for columns, over in by_pairs(found):
        part = {name: [p for p in pairs if (p.scene, p.pair) in over] for name, pairs in found.items()}
        beside = any(c.metric == "rep" for c in columns) and (entry.paper or any(m["paper"] for m in methods))
        header = ["method", "keypoints (least)", *(c.title for c in columns)]
        header += [f"the paper's {name}" for name in paper.DATASETS] if beside else []
        rows = []
        for method in methods:
            pairs = part[method["name"]]
            row = [method["name"], _counted(pairs), *(c.cell(pairs) for c in columns)]
            rows.append(row + (_paper(method["paper"]) if beside else []))
        if beside and entry.paper and counts == results.protocol["counts"][0]:
            ours = {m["paper"] for m in methods}
            absent = [name for name in paper.TABLES[entry.paper] if name not in ours]
            rows += [[name, "not measured", *("-" for _ in columns), *_paper(name)] for name in absent]
        tables.append(Table(_caption(results, dataset, counts, list(part.values())), header, rows))
    return tables


def _paper(row: str | None) -> list[str]:
    return [paper.figures(row, name) for name in paper.DATASETS]


def _counted(pairs: list[PairResult]) -> str:
    if not pairs:
        return "-"
    count = keypoints(pairs)
    return f"{count.mean:.0f} ({count.least})"


def _by_parameter(results: Results, dataset: dict[str, Any], methods: list[dict[str, Any]], counts: str) -> Table:
    found = [results.of(dataset["name"], method["name"], counts) for method in methods]
    values = sorted({p.parameter for pairs in found for p in pairs if p.parameter is not None})
    rows = []
    for method, pairs in zip(methods, found, strict=True):
        row = [method["name"]]
        for value in values:
            there = [p for p in pairs if p.parameter == value]
            numbers = image_counts(there, second=True).values()
            scores = f"{short(summarize(there, 'rep'))} / {short(summarize(there, 'ms'))}"
            row.append(f"{scores} ({sum(numbers) / len(numbers):.0f})" if numbers else "-")
        rows.append(row)
    title = f"{_caption(results, dataset, counts, found)}: rep / ms (keypoints of the view) by {dataset['parameter']}"
    return Table(title, ["method", *(f"{value:g}" for value in values)], rows)


def _by_threshold(results: Results, dataset: dict[str, Any], methods: list[dict[str, Any]], counts: str) -> Table:
    found = [having(results.of(dataset["name"], m["name"], counts), f"mma@{MMA_THRESHOLDS[0]}") for m in methods]
    rows = []
    for method, pairs in zip(methods, found, strict=True):
        values = [short(summarize(pairs, f"mma@{t}")) for t in MMA_THRESHOLDS]
        rows.append([method["name"], _counted(pairs), *values])
    header = ["method", "keypoints (least)", *(f"{t} px" for t in MMA_THRESHOLDS)]
    return Table(f"{_caption(results, dataset, counts, found)}: share of the matches within", header, rows)
