"""The page of structure from motion from few images."""

from __future__ import annotations

from collections.abc import Sequence

from elf_eval.metrics.pose import MAP_THRESHOLDS
from elf_eval.protocol import Protocol
from elf_eval.run.sfm import Reconstruction
from elf_eval.run.sfm_study import Study, mean_average_precision

from .table import Table

_NOTE = (
    "COLMAP places the images of a subset by each method's matches, with the true intrinsics, on one thread. The "
    "relative pose of every two images that are a pair of the dataset is held against the true one, of the whole set; "
    "its error is the larger angle of rotation and translation, and infinite where an image was not placed. mAP: the "
    "mean of the shares of pairs below 5, 10, ... degrees, up to the one named; over the pairs of a subset, then over "
    "subsets, in percent."
)


def sfm_page(study: Study, title: str, note: str, protocol: Protocol, command: str) -> str:
    """Markdown: a table for each dataset and size of subsets."""
    size = "images as they are" if protocol.size is None else f"images at {protocol.size[0]}x{protocol.size[1]}"
    facts = [
        f"Made by `{command}`.",
        f"Protocol: {size}, at most {protocol.max_keypoints} keypoints, mutual nearest neighbours"
        + (f", ratio {protocol.ratio} where a method has none of its own." if protocol.ratio else "."),
        *(f"Not measured: {absent['name']}: {absent['reason']}." for absent in study.skipped),
    ]
    parts = [f"# {title}", note, _NOTE, "\n".join(f"- {fact}" for fact in facts)]
    for dataset, count in dict.fromkeys((dataset, size) for dataset, _, size in study.found):
        each = {method: found for (d, method, s), found in study.found.items() if (d, s) == (dataset, count)}
        parts.append(_table(dataset, count, each).markdown())
    return "\n\n".join(filter(None, parts)) + "\n"


def _table(dataset: str, size: int, each: dict[str, list[Reconstruction]]) -> Table:
    subsets = next(iter(each.values()))
    scenes = len({one.scene for one in subsets})
    caption = f"{dataset}, {size} images ({_number(len(subsets), 'subset')} of {_number(scenes, 'scene')})"
    at = " / ".join(map(str, MAP_THRESHOLDS))
    header = ["method", "keypoints (least)", f"mAP@{at}", "images placed", "points", "images a point"]
    return Table(caption, header, [[name, *_cells(found)] for name, found in each.items()])


def _number(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _cells(found: Sequence[Reconstruction]) -> list[str]:
    made = [one for one in found if one.points]
    counts = list({name: n for one in found for name, n in zip(one.images, one.keypoints, strict=True)}.values())
    return [
        f"{sum(counts) / len(counts):.0f} ({min(counts)})",
        " / ".join(f"{100 * value:.1f}" for value in mean_average_precision(found)),
        f"{sum(one.placed for one in found)} of {sum(len(one.images) for one in found)}",
        f"{sum(one.points for one in found) / len(found):.0f}",
        f"{sum(one.track_length for one in made) / len(made):.2f}" if made else "-",
    ]
