"""Several workloads timed side by side, in rounds, so that what slows the machine for a while slows all of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Workload:
    """One thing to time.

    Attributes
    ----------
    run : function
        Does the work once; returns the number of keypoints (None for a saliency map alone) and the seconds of
        each stage (empty where there are none).
    """

    name: str
    title: str
    run: Callable[[], tuple[int | None, dict[str, float]]]


def interleaved(
    workloads: Sequence[Workload], warmup: int, repeats: int, after_round: Callable[[], object] = lambda: None
) -> tuple[dict[str, list[float]], dict[str, int]]:
    """Run every workload once a round, in rotating order, and call `after_round` after each.

    Returns
    -------
    samples : dict
        Workload, or ``workload.stage`` -> seconds of each repetition.
    keypoints : dict
        Workload -> number of keypoints, of those that find any.
    """
    samples: dict[str, list[float]] = {}
    keypoints: dict[str, int] = {}
    for turn in range(warmup + repeats):
        first = turn % len(workloads)
        for workload in [*workloads[first:], *workloads[:first]]:
            # Threads may spin after their work (OpenMP's do, for milliseconds) and take cores from the next workload.
            time.sleep(0.01)
            start = time.perf_counter()
            count, stages = workload.run()
            total = time.perf_counter() - start
            if turn < warmup:
                continue
            samples.setdefault(workload.name, []).append(total)
            for stage, seconds in with_sums(stages).items():
                samples.setdefault(f"{workload.name}.{stage}", []).append(seconds)
            if count is not None:
                keypoints[workload.name] = count
        after_round()
    # In the order of the workloads, whichever of them came first.
    order = [workload.name for workload in workloads]
    names = sorted(samples, key=lambda name: order.index(name.partition(".")[0]))
    return {name: samples[name] for name in names}, keypoints


def with_sums(stages: dict[str, float]) -> dict[str, float]:
    """`stages`, and two sums of each detection (percentiles don't add up).

    "post-processing" is what follows the network, unless it is in the graph; "detect + describe" is all but the
    decoding of the file, which is what OpenCV's ``detectAndCompute`` does.
    """
    after = [stages[name] for name in ("blur", "threshold", "nms", "descriptors") if name in stages]
    if not after and "session" not in stages:
        return stages
    sums = {"post-processing": sum(after)} if after else {}
    return {**stages, **sums, "detect + describe": sum(s for name, s in stages.items() if name != "read")}
