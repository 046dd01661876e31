"""How near a run of elf-detect on a folder comes to what the network alone allows, and whether its memory stays flat.

    python benchmarks/folder_throughput.py FOLDER [--rounds 5] [--preset P]

Each round runs, one after the other: the network alone on the folder's images, which are decoded and resized before the
clock starts; `ElfRuntime.detect` on the decoded images; and elf-detect, files to files.  All three share the cores
alike: as many images at once, with as many threads each, as elf-detect takes by default.  Ratios are medians over the
rounds.  Peak memory is that of fresh processes that run elf-detect on the folder's images once, and on four copies.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median

from elf_runtime import ElfRuntime
from elf_runtime.commands.cores import opencv_threads, shared_cores
from elf_runtime.commands.detect import main as elf_detect
from elf_runtime.commands.inputs import image_files
from elf_runtime.extraction.overlap import overlapped
from elf_runtime.image import read

_PEAK = """
import sys
from elf_runtime.commands.detect import main
status = main(sys.argv[1:])
print(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))
sys.exit(status)
"""


def images_a_second(work: Callable[[], object], images: int) -> float:
    start = time.perf_counter()
    work()
    return images / (time.perf_counter() - start)


def compare(folder: Path, rounds: int, options: Sequence[str], preset: str | None) -> None:
    paths = list(image_files([str(folder)]))
    workers, threads = shared_cores(None, None, len(paths))
    elf = ElfRuntime(threads=threads)
    params, spec = elf.params(preset), elf.contract.descriptor()
    decoded = [read(path) for path in paths]
    prepared = [elf._prepare(pixels, params).image[0].pixels for pixels in decoded]

    def network() -> None:
        for _ in overlapped(lambda pixels: elf._network.run([pixels], spec), prepared, workers):
            pass

    def detect() -> None:
        for _ in overlapped(lambda pixels: elf.detect(pixels, params=params), decoded, workers):
            pass

    def command() -> None:
        with tempfile.TemporaryDirectory() as out:
            assert elf_detect([str(folder), "-o", out, "--quiet", *options]) == 0

    contenders = {"network alone": network, "detect, in memory": detect, "elf-detect, files to files": command}
    samples: dict[str, list[float]] = {name: [] for name in contenders}
    with opencv_threads(1 if workers > 1 else None):
        for turn in range(rounds + 1):
            for name, work in contenders.items():
                rate = images_a_second(work, len(paths))
                if turn:  # the first one warms up
                    samples[name].append(rate)
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    print(f"{len(paths)} images, {workers} at once with {threads} threads each, {rounds} rounds, load {load:.1f}")
    for name, rates in samples.items():
        shares = [rate / alone for rate, alone in zip(rates, samples["network alone"], strict=True)]
        print(f"{name:<28}{median(rates):8.1f} images/s   {median(shares):.2f} of the network alone")


def peaks(folder: Path, options: Sequence[str]) -> None:
    if not Path("/proc/self/status").exists():
        print("peak memory: not measured, for want of /proc")
        return
    with tempfile.TemporaryDirectory() as scratch:
        four = Path(scratch, "four")
        for copy in range(4):
            shutil.copytree(folder, four / str(copy))
        for source in (folder, four):
            out = Path(scratch, f"out-{source.name}")
            words = [str(source), "-r", "-o", str(out), "--quiet", *options]
            done = subprocess.run([sys.executable, "-c", _PEAK, *words], capture_output=True, text=True, check=True)
            images = len(list(out.rglob("*.npz")))
            print(f"peak memory on {images} images: {int(done.stdout.split()[-1]) / 1024:.0f} MiB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--preset")
    args = parser.parse_args()
    options = ["--preset", args.preset] if args.preset else []
    compare(args.folder, args.rounds, options, args.preset)
    peaks(args.folder, options)


if __name__ == "__main__":
    main()
