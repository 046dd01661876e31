"""Structure from motion of every method from subsets of every scene, with the features of the cache."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from elf_eval.data import Dataset
from elf_eval.errors import EvalError
from elf_eval.metrics.pose import MAP_THRESHOLDS
from elf_eval.suite.suite import Suite

from .cache import load
from .progress import Progress
from .runner import Resources, extracted, open_datasets
from .sfm import Reconstruction, reconstruct
from .subsets import Subset, draw_subsets


@dataclass(frozen=True)
class Study:
    """What was reconstructed.

    Attributes
    ----------
    found : dict
        Dataset, method and size of the subsets -> a reconstruction of each subset.
    skipped : list of dict
        Methods and datasets that could not be opened, and sizes that scenes are too small for, with the reasons.
    """

    found: dict[tuple[str, str, int], list[Reconstruction]]
    skipped: list[dict[str, str]]

    def to_json(self) -> Any:
        """Plain data; an infinite error is null."""
        return [
            {
                **dict(zip(("dataset", "method", "size"), key, strict=True)),
                "subsets": [{**asdict(one), "errors": [_plain(e) for e in one.errors]} for one in each],
            }
            for key, each in self.found.items()
        ]


def study(suite: Suite, sizes: Sequence[int], count: int, seed: int, resources: Resources) -> Study:
    """Draw `count` subsets of each size from every scene, and reconstruct each by every method's matches.

    Raises
    ------
    EvalError
        As in `runner.run`; if no scene has images enough for any size, or poses are not known.
    """
    datasets, skipped = open_datasets(suite)
    subsets: dict[tuple[str, int], list[Subset]] = {}
    for entry, dataset in datasets:
        if unposed := next((pair for pair in dataset.pairs if "pose" not in pair.truth.known()), None):
            raise EvalError(f"{entry.name}: {unposed.name}: structure from motion needs pairs whose poses are known")
        for size in sizes:
            subsets[entry.name, size] = _drawn(dataset, size, count, seed, skipped, entry.name)
    if not any(subsets.values()):
        raise EvalError(f"no scene has {min(sizes)} images that hang together")
    refs = list(dict.fromkeys(ref for each in subsets.values() for subset in each for ref in subset))
    methods, features, absent = extracted(suite, refs, resources)
    progress = Progress("reconstructions", len(methods) * sum(map(len, subsets.values())), quiet=resources.quiet)
    found: dict[tuple[str, str, int], list[Reconstruction]] = {}
    for entry, dataset in datasets:
        truths = {(pair.first, pair.second): pair for pair in dataset.pairs}
        for name, protocol in methods.items():
            loaded = {ref: done for ref in refs if (done := load(features[name, ref].path)) is not None}
            for size in sizes:
                each = []
                for subset in subsets[entry.name, size]:
                    each.append(reconstruct(subset, loaded, truths, protocol))
                    progress.step(f"{name}: {size} images of {each[-1].scene}")
                if each:
                    found[entry.name, name, size] = each
    return Study(found, [*skipped, *absent])


def mean_average_precision(found: Sequence[Reconstruction]) -> list[float]:
    """The challenge's mAP up to each of `MAP_THRESHOLDS` degrees, over all pairs of each subset, then over subsets."""
    shares = [[sum(e < t for e in one.errors) / len(one.errors) for t in MAP_THRESHOLDS] for one in found]
    means = [sum(column) / len(column) for column in zip(*shares, strict=True)]
    return [sum(means[:n]) / n for n in range(1, len(means) + 1)]


def _drawn(
    dataset: Dataset, size: int, count: int, seed: int, skipped: list[dict[str, str]], name: str
) -> list[Subset]:
    drawn: list[Subset] = []
    for scene in dataset.scenes():
        here = draw_subsets(dataset.only([scene]).pairs, size, count, seed)
        if not here:
            skipped.append({"name": f"{size} images of {name}/{scene}", "reason": "there are not so many in pairs"})
        drawn += here
    return drawn


def _plain(error: float) -> float | None:
    return None if error == float("inf") else round(error, 4)
