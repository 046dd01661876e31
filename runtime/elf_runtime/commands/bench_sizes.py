"""The image sizes of elf-bench: what runs on each, and what was measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from elf_runtime.engine import ElfRuntime
from elf_runtime.timing.interleave import Workload, interleaved
from elf_runtime.timing.statistics import paired_ratio, summary

from .bench_workloads import Image

_RATIOS = (
    ("elf.detect + describe", "sift"),
    ("elf.detect + describe", "orb"),
    ("elf_saliency", "elf_saliency_twin"),
    ("elf_saliency_twin", "torch"),
    ("elf_saliency", "torch"),
)


@dataclass
class SizeRun:
    """The workloads on the image of one size, with the seconds and the keypoints of each."""

    image: Image
    workloads: list[Workload]
    samples: dict[str, list[float]] = field(default_factory=dict)
    keypoints: dict[str, int] = field(default_factory=dict)

    def entry(self) -> dict[str, Any]:
        """This size's part of the report: samples in seconds, their percentiles, and ratios."""
        pairs = [pair for pair in _RATIOS if all(name in self.samples for name in pair)]
        return {
            "height": self.image.shape[0],
            "width": self.image.shape[1],
            "keypoints": self.keypoints,
            "titles": {workload.name: workload.title for workload in self.workloads},
            "seconds": {name: asdict(summary(values)) for name, values in self.samples.items()},
            "ratios": {f"{a} / {b}": asdict(paired_ratio(self.samples[a], self.samples[b])) for a, b in pairs},
            "samples": self.samples,
        }

    def agreement(self, elf: ElfRuntime, torch_saliency: Any) -> dict[str, Any]:
        """The share of the pixels where the graph that has torch's weights agrees with torch."""
        reference, found = torch_saliency(self.image), elf.saliency(self.image, scale=1.0)
        share = float(np.mean(np.abs(found - reference) <= 1e-4 * reference.max()))
        return {"precision": elf.contract.precision, "share": share}


def time_in_turn(runs: Sequence[SizeRun], warmup: int, repeats: int, after_round: Callable[[], object]) -> None:
    """Fill in what is measured; the workloads of all sizes take turns."""
    numbered = [replace(work, name=f"{i}:{work.name}") for i, run in enumerate(runs) for work in run.workloads]
    samples, keypoints = interleaved(numbered, warmup, repeats, after_round)
    for i, run in enumerate(runs):
        mine = f"{i}:"
        run.samples = {name.removeprefix(mine): v for name, v in samples.items() if name.startswith(mine)}
        run.keypoints = {name.removeprefix(mine): v for name, v in keypoints.items() if name.startswith(mine)}
