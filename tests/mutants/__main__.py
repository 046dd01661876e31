"""Try thousands of damaged models and images: ``PYTHONPATH=tests python -m mutants --models 3000 --images 500``.

Ends with 1 if anything but an error of the project's own came out, or a mutant took more than 20 s or 1.5 GB.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
from importlib.util import find_spec

from . import jobs
from .trial import Outcome, trial


def main() -> int:
    parser = argparse.ArgumentParser(prog="mutants", description=__doc__)
    parser.add_argument("--models", type=int, default=3000, help="mutants of models; default: 3000")
    parser.add_argument("--images", type=int, default=500, help="mutants of images and arrays; default: 500")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2, help="processes at a time; default: 2")
    args = parser.parse_args()
    foreign = args.models // 3 if find_spec("onnx") else 0
    counts = {"elf_models": args.models - foreign, "foreign_models": foreign, "picture_files": args.images}
    faults = 0
    for kind, count in counts.items():
        if not count:
            continue
        parts = [(kind, args.seed, count, part, args.workers) for part in range(args.workers)]
        # Forked processes of one thread each: a fork beside other threads inherits their locks.
        with multiprocessing.get_context("fork").Pool(args.workers) as pool:
            found = [outcome for part in pool.map(tried, parts, chunksize=1) for outcome in part]
        print(summary(kind.replace("_", " "), found), flush=True)
        faults += sum(bool(outcome.fault) for outcome in found)
    return 1 if faults else 0


def tried(share: tuple[str, int, int, int, int]) -> list[Outcome]:
    """Every `step`-th of the mutants of one kind, from `part` on."""
    kind, seed, count, part, step = share
    found = []
    for number, (what, work) in enumerate(getattr(jobs, kind)(seed, count)):
        if number % step != part:
            continue
        found.append(trial(what, work))
        if found[-1].fault:
            print(f"FAULT {what}\n{found[-1].fault}\n", flush=True)
    return found


def summary(kind: str, found: list[Outcome]) -> str:
    refused, faults = sum(o.refused for o in found), sum(bool(o.fault) for o in found)
    slowest, largest = max(found, key=lambda o: o.seconds), max(found, key=lambda o: o.bytes)
    return (
        f"{kind}: {len(found)} mutants, {len(found) - refused - faults} taken, {refused} refused, {faults} faults; "
        f"at most {slowest.seconds:.1f} s ({slowest.what[:80]}), {largest.bytes / 2**20:.0f} MiB ({largest.what[:80]})"
    )


if __name__ == "__main__":
    sys.exit(main())
