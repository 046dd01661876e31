"""What a table or a plot shows: some methods on one dataset, by one way of counting."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from elf_eval.run.results import PairResult, Results
from elf_eval.suite.suite import TableEntry


@dataclass(frozen=True)
class Selection:
    """A part of the results.

    Attributes
    ----------
    dataset : dict
    methods : list of dict
        As in the results, in the order of the table.
    counts : "own" or "equal"
    """

    results: Results
    dataset: dict[str, Any]
    methods: list[dict[str, Any]]
    counts: str

    @cached_property
    def pairs(self) -> dict[str, list[PairResult]]:
        """Each method's pairs, by its name."""
        return {m["name"]: self.results.of(self.dataset["name"], m["name"], self.counts) for m in self.methods}

    @property
    def parameters(self) -> list[float]:
        """The values of the pairs' parameter, such as angles."""
        return sorted({p.parameter for pairs in self.pairs.values() for p in pairs if p.parameter is not None})

    @property
    def count_floor(self) -> int:
        return int(self.results.protocol.get("count_floor", 0))

    @property
    def title(self) -> str:
        """The dataset, and how many keypoints are kept."""
        if self.counts == "own":
            how = f"up to {self.results.protocol['max_keypoints']} keypoints"
        else:
            how = f"equal counts, at least {self.count_floor}" if self.count_floor else "equal counts"
        return f"{self.dataset['name']}, {how}"


def selections(results: Results, entry: TableEntry) -> Iterator[Selection]:
    """The datasets and methods of an entry that the results have, in the entry's order, by each way of counting."""
    datasets = {d["name"]: d for d in results.datasets}
    methods = {m["name"]: m for m in results.methods}
    chosen = [methods[n] for n in entry.methods or methods if n in methods]
    for name in entry.datasets or datasets:
        if name in datasets:
            for counts in results.protocol["counts"]:
                yield Selection(results, datasets[name], chosen, counts)
