"""The tables: in the paper's form, with what is compared today beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from elf_eval.metrics.matching_accuracy import MMA_THRESHOLDS
from elf_eval.run.averages import having, image_counts, keypoints, summarize
from elf_eval.run.results import PairResult, Results
from elf_eval.suite import paper
from elf_eval.suite.paper_logs import CURVES, experiment
from elf_eval.suite.suite import TableEntry

from .columns import Column, by_pairs, short
from .paper_rows import curve_rows, has_rows, paper_columns, scene_tables, stands_beside
from .selection import Selection, selections
from .table import Table

Found = Mapping[str, Sequence[PairResult]]  # pairs by method


def build(results: Results, entry: TableEntry) -> list[Table]:
    """The tables of an entry: one for each dataset and way of counting.

    Metrics that are over different pairs stand in tables of their own.
    """
    tables = []
    for part in selections(results, entry):
        if entry.plot == "mma":
            tables.append(_by_threshold(part))
            continue
        tables += _main(part, entry)
        if part.dataset["parameter"]:
            tables.append(_by_parameter(part, has_rows(part, entry)))
        if experiment(part.dataset) == "viewpoint" and stands_beside(part, entry):
            tables += scene_tables(part, has_rows(part, entry))
    return tables


def _caption(part: Selection, found: Found) -> str:
    """The dataset, how many keypoints are kept, and over how many pairs and scenes a table is."""
    there = {(p.scene, p.pair) for pairs in found.values() for p in pairs}
    scenes = {scene for scene, _ in there}
    over = (len(there), part.dataset["pairs"], "pair"), (len(scenes), part.dataset["scenes"], "scene")
    numbers = ", ".join(f"{n if n == of else f'{n} of {of}'} {what}{'' if of == 1 else 's'}" for n, of, what in over)
    text = f"{part.title} ({numbers})"
    if part.counts == "equal" and part.count_floor:
        images = [item for pairs in found.values() for item in image_counts(pairs).items()]
        fewer = {name for name, count in images if count < part.count_floor}
        text += f"; on {len(fewer)} of {len(dict(images))} images a method finds fewer than {part.count_floor}"
    return text


def _main(part: Selection, entry: TableEntry) -> list[Table]:
    tables = []
    groups = by_pairs(part.pairs)
    place = _place_of_paper(part, groups) if stands_beside(part, entry) else None
    for number, (columns, over) in enumerate(groups):
        found = {name: [p for p in pairs if (p.scene, p.pair) in over] for name, pairs in part.pairs.items()}
        theirs = paper_columns(part, {scene for scene, _ in over}) if number == place else []
        header = ["method", "keypoints (least)", *(c.title for c in columns), *(c.title for c in theirs)]
        rows = []
        for method in part.methods:
            pairs = found[method["name"]]
            row = [method["name"], _counted(pairs), *(c.cell(pairs) for c in columns)]
            rows.append([*row, *(c.cell(method["paper"]) for c in theirs)])
        if theirs and entry.paper and has_rows(part, entry):
            ours = {m["paper"] for m in part.methods}
            none = ["not measured", *("-" for _ in columns)]
            absent = [name for name in paper.TABLES[entry.paper] if name not in ours]
            rows += [[name, *none, *(c.cell(name) for c in theirs)] for name in absent]
        tables.append(Table(_caption(part, found), header, rows))
    return tables


def _place_of_paper(part: Selection, groups: Sequence[tuple[Sequence[Column], object]]) -> int | None:
    """Which of the tables has the paper's columns: that of rep; of a viewpoint without depth the first."""
    with_rep = [n for n, (columns, _) in enumerate(groups) if any(c.metric == "rep" for c in columns)]
    return next(iter(with_rep), 0 if experiment(part.dataset) == "viewpoint" else None)


def _counted(pairs: Sequence[PairResult]) -> str:
    if not pairs:
        return "-"
    count = keypoints(pairs)
    return f"{count.mean:.0f} ({count.least})"


def _by_parameter(part: Selection, rows_of_paper: bool) -> Table:
    rows = []
    for name, pairs in part.pairs.items():
        row = [name]
        for value in part.parameters:
            there = [p for p in pairs if p.parameter == value]
            numbers = image_counts(there, second=True).values()
            scores = f"{short(summarize(there, 'rep'))} / {short(summarize(there, 'ms'))}"
            row.append(f"{scores} ({sum(numbers) / len(numbers):.0f})" if numbers else "-")
        rows.append(row)
    if rows_of_paper and (curves := CURVES.get(experiment(part.dataset))):
        rows += curve_rows(curves, part.parameters)
    what = f"rep / ms (keypoints of the view) by {part.dataset['parameter']}"
    return Table(f"{_caption(part, part.pairs)}: {what}", ["method", *(f"{v:g}" for v in part.parameters)], rows)


def _by_threshold(part: Selection) -> Table:
    found = {name: having(pairs, f"mma@{MMA_THRESHOLDS[0]}") for name, pairs in part.pairs.items()}
    rows = [
        [name, _counted(pairs), *(short(summarize(pairs, f"mma@{t}")) for t in MMA_THRESHOLDS)]
        for name, pairs in found.items()
    ]
    header = ["method", "keypoints (least)", *(f"{t} px" for t in MMA_THRESHOLDS)]
    return Table(f"{_caption(part, found)}: share of the matches within", header, rows)
