"""What a reader must know of the paper's figures that stand beside ours."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from elf_eval.run.results import Results
from elf_eval.suite.paper_logs import experiment

from .paper_rows import values

_VIEWS = "image 1 of each of HPatches' 116 scenes against views of itself"


def stands_on_page(results: Results) -> bool:
    """Whether some of the paper's figures stand on the page of these results."""
    kinds = {experiment(d) for d in results.datasets} - {"image matching"}
    return bool(kinds) and any(m["paper"] for m in results.methods)


def paper_facts(results: Results) -> list[str]:
    """Where the paper's figures come from, and what differs; nothing where none stand on the page."""
    if not stands_on_page(results):
        return []
    kinds = {experiment(d) for d in results.datasets}
    facts = ["The paper's columns: rep / ms; -: it has no such row; not given: its figure is not known here."]
    if "generic" in kinds:
        facts.append("Of the paper's numbers of keypoints only the limit of 500 is known here.")
    if kinds & {"scale", "rotation", "viewpoint"}:
        facts.append(
            f"The paper's {' and '.join(k for k in ('rotation', 'scale', 'viewpoint') if k in kinds)}: from the logs "
            "that its authors published (github.com/abenbihi/elf, plots/res). ELF-VGG there has denoising (5, 2) and "
            "threshold (17, 6), SIFT is OpenCV 3.4's, the others have their authors' weights; at most 500 keypoints, "
            "whose numbers are not given here. Means are over all their pairs."
        )
    facts += [_curve_facts(kind, results) for kind in ("rotation", "scale") if kind in kinds]
    if kinds & {"scale", "rotation"}:
        facts.append("In the logs of scale and rotation i_objects and i_table have the same figures, of every method.")
    if "viewpoint" in kinds:
        facts.append(
            "The paper's viewpoint: the first image of fountain-P11, entry-P10 and Herz-Jesu-P8 against each other "
            "one, with COLMAP's depth; its columns and rows are of the scenes that were measured here."
        )
    return facts


def _curve_facts(kind: str, results: Results) -> str:
    """Over which views the paper's means are, and where ours are of others."""
    at = values(kind)
    text = f"The paper's {kind}: {_VIEWS}, at {_listed(at)}"
    if kind == "rotation":
        text += " degrees, which the authors' plot names and the logs don't"
    for dataset in (d for d in results.datasets if experiment(d) == kind):
        if (ours := _measured(dataset, results)) != at:
            text += f"; {dataset['name']} has {_listed(ours)}, so the means are not of the same views"
    text += "."
    if kind == "rotation":
        text += " LIFT's log repeats the figures of 130 degrees at 170 for v_feast and v_wall."
    return text


def _measured(dataset: Mapping[str, Any], results: Results) -> list[float]:
    name = dataset["name"]
    return sorted({p.parameter for p in results.pairs if p.dataset == name and p.parameter is not None})


def _listed(numbers: list[float]) -> str:
    *rest, last = [f"{n:g}" for n in numbers]
    return f"{', '.join(rest)} and {last}" if rest else last
