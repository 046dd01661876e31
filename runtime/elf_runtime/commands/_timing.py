"""elf-bench's clock."""

from __future__ import annotations

import time
from collections.abc import Sequence

from ._contenders import Contender


def interleaved(
    contenders: Sequence[Contender], warmup: int, repeats: int
) -> tuple[dict[str, list[float]], dict[str, int]]:
    """Run every contender once a round, in rotating order.

    Returns
    -------
    samples : dict
        Contender, or ``contender.stage`` -> seconds of each repetition.
    keypoints : dict
        Contender -> number of keypoints, of those that find any.
    """
    samples: dict[str, list[float]] = {}
    keypoints: dict[str, int] = {}
    for turn in range(warmup + repeats):
        first = turn % len(contenders)
        for contender in [*contenders[first:], *contenders[:first]]:
            # Threads that spin after their work (OpenMP's, for milliseconds) would take the next one's cores.
            time.sleep(0.01)
            start = time.perf_counter()
            count, stages = contender.run()
            total = time.perf_counter() - start
            if turn < warmup:
                continue
            samples.setdefault(contender.name, []).append(total)
            for stage, seconds in with_sums(stages).items():
                samples.setdefault(f"{contender.name}.{stage}", []).append(seconds)
            if count is not None:
                keypoints[contender.name] = count
    # By contender in the order given, whichever round came first.
    order = [contender.name for contender in contenders]
    names = sorted(samples, key=lambda name: order.index(name.partition(".")[0]))
    return {name: samples[name] for name in names}, keypoints


def with_sums(stages: dict[str, float]) -> dict[str, float]:
    """`stages`, and two sums of each detection (percentiles don't add up).

    "post-processing" is what follows the network; "detect + describe" is all but the decoding of the file, which is
    what OpenCV's ``detectAndCompute`` does.
    """
    after = [stages[name] for name in ("blur", "threshold", "nms", "descriptors") if name in stages]
    if not after:
        return stages
    work = [seconds for name, seconds in stages.items() if name != "read"]
    return {**stages, "post-processing": sum(after), "detect + describe": sum(work)}
