"""What of the paper stands beside a part of the results: columns of a main table, rows of curves, scenes by image."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import PurePath

from elf_eval.run.averages import having, summarize
from elf_eval.run.results import PairResult
from elf_eval.suite import paper
from elf_eval.suite.paper_logs import CURVES, LOGGED, VIEWPOINT, Curve, Curves, Score, experiment, mean, scene_of
from elf_eval.suite.suite import TableEntry

from .columns import short
from .selection import Selection
from .table import Table

THE_PAPER = "the paper: "  # before its rows, among ours


@dataclass(frozen=True)
class PaperColumn:
    """A column's title, and its cell for a row of the paper, or for a method that has none."""

    title: str
    cell: Callable[[str | None], str]


def stands_beside(part: Selection, entry: TableEntry) -> bool:
    """Whether the paper's figures are asked for: by the table, or by a method."""
    return bool(entry.paper) or any(m["paper"] for m in part.methods)


def has_rows(part: Selection, entry: TableEntry) -> bool:
    """Whether rows of the paper stand below ours: once for each dataset, in the first way of counting."""
    return stands_beside(part, entry) and part.counts == part.results.protocol["counts"][0]


def paper_columns(part: Selection, scenes: Collection[str]) -> list[PaperColumn]:
    """The paper's columns of a main table over these scenes: by its two datasets, or the means of its logs."""
    kind = experiment(part.dataset)
    if kind == "generic":
        return [PaperColumn(f"the paper's {name}", partial(_of_table, name)) for name in paper.DATASETS]
    if kind in CURVES:
        return [_mean_column(f"mean at {' / '.join(f'{v:g}' for v in values(kind))}", [CURVES[kind]])]
    if kind != "viewpoint":
        return []
    known = [scene for scene in VIEWPOINT if scene in {scene_of(name) for name in scenes}]
    columns = [_mean_column(f"{scene}, {len(_any(VIEWPOINT[scene]))} pairs", [VIEWPOINT[scene]]) for scene in known]
    if len(known) == len(VIEWPOINT):
        columns.append(_mean_column(f"{sum(len(_any(c)) for c in VIEWPOINT.values())} pairs", list(VIEWPOINT.values())))
    return columns


def values(kind: str) -> list[float]:
    """The factors or angles of the paper's scale or rotation."""
    return list(_any(CURVES[kind]))


def curve_rows(curves: Curves, at: Sequence[float], and_mean: bool = False) -> list[list[str]]:
    """Rows ``the paper: NAME`` of ``rep / ms`` at the values `at`; none where the paper has none of the values."""
    if not set(at) & set(_any(curves)):
        return []
    rows = []
    for row in LOGGED:
        cells = [score_text(curves[row].get(value)) for value in at]
        rows.append([f"{THE_PAPER}{row}", *cells, *([score_text(mean(curves[row].values()))] if and_mean else [])])
    return rows


def scene_tables(part: Selection, rows_of_paper: bool) -> list[Table]:
    """Of each of Strecha's scenes a table by second image, for the pairs that the paper has, with its rows."""
    tables = []
    for name in dict.fromkeys(p.scene for pairs in part.pairs.values() for p in pairs):
        scene = scene_of(name)
        if scene is None:
            continue
        found = {
            method: {number: p for p in pairs if p.scene == name and (number := image_number(p)) is not None}
            for method, pairs in part.pairs.items()
        }
        at = list(_any(VIEWPOINT[scene]))
        there = {number for of_method in found.values() for number in of_method} & set(at)
        if not there:
            continue
        deep = any("rep" in p.metrics for of_method in found.values() for p in of_method.values())
        measured = {n for of_method in found.values() for n in there if _measured(of_method.get(n), deep)}
        rows = [[method, *_by_image([of_method.get(n) for n in at], deep)] for method, of_method in found.items()]
        rows += curve_rows(VIEWPOINT[scene], at, and_mean=True) if rows_of_paper else []
        what = "rep / ms" if deep else "ms by lines, having no depth"
        theirs = "" if deep or not rows_of_paper else "; the paper's: rep / ms by depth"
        caption = (
            f"{part.title}, {name} ({pairs_text(len(measured), len(there))}): "
            f"{what} (keypoints of the image), of the first image against each other one{theirs}"
        )
        tables.append(Table(caption, ["method", *(f"{n:04.0f}" for n in at), "mean"], rows))
    return tables


def image_number(pair: PairResult) -> float | None:
    """The number of a pair's second image, where the first one is 0000, as in Strecha's scenes; else None."""
    first, second = (PurePath(name).stem for name in (pair.first, pair.second))
    return float(second) if first.isdecimal() and int(first) == 0 and second.isdecimal() else None


def pairs_text(measured: int, of: int) -> str:
    """``9 pairs``, or ``5 of 9 pairs``."""
    return f"{of if measured == of else f'{measured} of {of}'} pair{'' if of == 1 else 's'}"


def score_text(score: Score | None) -> str:
    """``rep / ms`` in percent."""
    return "-" if score is None else f"{score[0]:.1f} / {score[1]:.1f}"


def _by_image(pairs: Sequence[PairResult | None], deep: bool) -> list[str]:
    """Cells of one method's pairs, and of their mean."""
    metrics = ("rep", "ms") if deep else ("epi_ms",)

    def cell(over: list[PairResult], count: float) -> str:
        return f"{' / '.join(short(summarize(over, metric)) for metric in metrics)} ({count:.0f})"

    there = [p for p in pairs if p is not None and _measured(p, deep)]
    counts = {p.second: float(p.metrics["n2"] or 0) for p in there}
    cells = [cell([p], counts[p.second]) if p in there else "-" for p in pairs]
    return [*cells, cell(there, sum(counts.values()) / len(there)) if there else "-"]


def _measured(pair: PairResult | None, deep: bool) -> bool:
    """Whether a pair has the scores of its scene's table."""
    return pair is not None and bool(having([pair], "ms" if deep else "epi_ms"))


def _any(curves: Curves) -> Curve:
    """A row's curve, for its values: those of all rows are the same."""
    return curves[LOGGED[0]]


def _mean_column(title: str, curves: Sequence[Curves]) -> PaperColumn:
    def cell(row: str | None) -> str:
        scores = [score for each in curves for score in each.get(row or "", {}).values()]
        return score_text(mean(scores) if scores else None)

    return PaperColumn(f"the paper's {title}", cell)


def _of_table(dataset: str, row: str | None) -> str:
    return paper.figures(row, dataset)
