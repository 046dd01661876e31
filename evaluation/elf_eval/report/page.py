"""The report: README.md and tables.csv, with the plots and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from elf_eval.metrics.epipolar import EPIPOLAR_ERROR
from elf_eval.run.results import Results
from elf_eval.suite.paper_logs import experiment
from elf_eval.suite.suite import TableEntry

from . import plots
from .metrics_csv import write_csv
from .paper_facts import paper_facts, stands_on_page
from .tables import build


def write_report(
    results: Results,
    out: Path,
    title: str,
    note: str,
    tables: list[TableEntry],
    command: str,
    pictures: list[Path],
) -> list[str]:
    """Write ``README.md``, ``tables.csv`` and ``plots/`` into `out`.

    Parameters
    ----------
    tables : list of TableEntry
        If empty, one table of everything.
    command : str
        What makes this report again.
    pictures : list of Path
        Pictures of matches inside `out`.

    Returns
    -------
    list of str
        The names that were written; ``plots/`` only where there are some.
    """
    out.mkdir(parents=True, exist_ok=True)
    write_csv(results, out / "tables.csv")
    parts = [f"# {title}", note, "\n".join(f"- {fact}" for fact in _facts(results, command))]
    plotted: list[Path] = []
    for number, entry in enumerate(tables or [TableEntry("All methods")], start=1):
        written = plots.plot(results, entry, out / "plots" / f"{number:02d}") if plots.available() else []
        plotted += written
        parts += [f"## {entry.title}", entry.note, *(table.markdown() for table in build(results, entry))]
        parts += [f"![{entry.title}](plots/{path.name})" for path in written]
    if pictures:
        parts += ["## Matches", "Green: right; red: wrong; blue: keypoints without a match."]
        parts += [f"![matches]({path.relative_to(out).as_posix()})" for path in pictures]
    (out / "README.md").write_text("\n\n".join(filter(None, parts)) + "\n", encoding="utf-8")
    return ["README.md", "tables.csv", *(["plots/"] if plotted else [])]


def _facts(results: Results, command: str) -> list[str]:
    """What a reader must know to judge the figures, or to make them again."""
    p = results.protocol
    size = "images as they are" if p["size"] is None else f"images at {p['size'][0]}x{p['size'][1]}"
    known = {name for pair in results.pairs for name in pair.metrics}
    facts = [
        f"Made by `{command}` on {results.created[:10]}.",
        f"Protocol: {size}, at most {p['max_keypoints']} keypoints, repeated within {p['eps']:g} px.",
    ]
    if "equal" in p["counts"]:
        facts.append(_equal(p.get("count_floor", 0)))
    facts.append(
        "Averaged per scene, then over scenes, in percent; in brackets: 95 % interval over scenes (Student's t)."
    )
    if ratios := _ratios(results):
        facts.append(ratios)
    if refined := [m["name"] for m in results.methods if m.get("refine")]:
        facts.append(_refined(refined, len(results.methods)))
    for title, estimated, settings in (
        ("Homographies", "h_error", p["homography"]),
        ("Relative poses, through the essential matrix,", "pose_error", p["pose"]),
    ):
        if estimated in known:
            facts.append(f"{title} from mutual nearest neighbours by OpenCV's {_estimator(settings)}.")
    if known & {"h_error", "pose_error"}:
        facts.append(
            "AUC: the area under the recall curve, which rises in a step at each error, averaged per scene, then over "
            "scenes. As SuperGlue: slopes join the sorted errors of all pairs together, as in its authors' code and in "
            "most papers since; compare published figures with this one."
        )
    if "pose_right@5" in known:
        facts.append(
            "mAP: as the Image Matching challenge of 2019 has it, the mean of the shares of pairs whose pose error is "
            "below 5, 10, ... degrees, up to the one named. It is never smaller than the AUC."
        )
    if EPIPOLAR_ERROR in known:
        facts.append(
            "Epipolar distance of a match: the root mean square of its two points' distances to each other's true "
            "epipolar lines (the symmetric distance of Hartley and Zisserman, 11.10). epi@: the share of the matches "
            "within so many px, and right their mean number. The median is over a pair's matches within 3 px, then "
            "over all pairs, of which one without any counts as infinite. ms by lines: matches of the paper's greedy "
            f"matching within {p['eps']:g} px of the lines, over the fewer keypoints of the pair; some lie there by "
            "chance, and no keypoint is left out for being out of sight, so it is not the ms by depth."
        )
    facts += paper_facts(results)
    facts.append("Versions: " + ", ".join(f"{name} {version}" for name, version in results.versions.items()) + ".")
    if not plots.available():
        facts.append("Plots are left out: matplotlib is not installed (it is in the extra 'eval').")
    facts += [_published(d, stands_on_page(results)) for d in results.datasets if _differs(d)]
    facts += [f"Not measured: {s['name']}: {s['reason']}." for s in results.skipped]
    return facts


def _differs(dataset: Mapping[str, Any]) -> bool:
    return any(dataset[what] != count for what, count in dataset.get("published", {}).items())


def _published(dataset: Mapping[str, Any], beside: bool) -> str:
    """How much of the paper's data was measured; `beside`: the page has columns of the paper's figures."""
    theirs = ", ".join(f"{count} {what}" for what, count in dataset["published"].items())
    scenes = f"{dataset['scenes']} scene{'' if dataset['scenes'] == 1 else 's'}"
    beside = beside and experiment(dataset) != "viewpoint"  # there the same pairs stand beside
    end = ": its columns are for orientation." if beside else "."
    return f"{dataset['name']}: {dataset['pairs']} pairs of {scenes} here, {theirs} in the paper{end}"


def _ratios(results: Results) -> str:
    """Which methods' matches pass a ratio test, in words; nothing where none do."""
    ratios = {m["name"]: m.get("ratio") for m in results.methods}
    if not any(ratios.values()):
        return ""
    each = ", ".join(f"{name} {'none' if ratio is None else ratio}" for name, ratio in ratios.items())
    same = set(ratios.values())
    return (
        "Matches are the mutual nearest neighbours whose distance is below a ratio of that to the second nearest in "
        f"the second image: {next(iter(same)) if len(same) == 1 else each}. ms is without."
    )


def _refined(names: Sequence[str], methods: int) -> str:
    of = "" if len(names) == methods else f" of {', '.join(names)}"
    return (
        f"Matches{of} are refined: each one's place in the second image is sought again by comparing the two images "
        "(elf_runtime.refine). rep and ms are without."
    )


def _equal(floor: int) -> str:
    text = "Equal counts: of each image, every method keeps as many as the one that found the fewest"
    if not floor:
        return text + "."
    return text + f", but at least {floor}: a method that found fewer than {floor} keeps what it found."


def _estimator(settings: Mapping[str, Any]) -> str:
    s = settings
    return (
        f"{s['estimator']}: {s['threshold']:g} px, {s['iterations']} iterations, confidence {s['confidence']}, "
        f"seed {s['seed']}"
    )


def write_index(out: Path) -> None:
    """Write `out`/README.md, with links to all pages in `out` and its folders by their titles."""
    pages = sorted([*out.glob("*/README.md"), *(page for page in out.glob("*.md") if page.name != "README.md")])
    titles = [page.read_text(encoding="utf-8").split("\n", 1)[0].removeprefix("# ") for page in pages]
    links = [f"- [{title}]({page.relative_to(out).as_posix()})\n" for title, page in zip(titles, pages, strict=True)]
    (out / "README.md").write_text("# Evaluation\n\n" + "".join(links), encoding="utf-8")
