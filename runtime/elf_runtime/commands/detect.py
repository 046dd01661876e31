"""elf-detect: keypoints and descriptors of images, videos and cameras, as files and pictures."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from itertools import chain
from pathlib import Path

from elf_runtime.engine import ElfRuntime
from elf_runtime.extraction.extractor import Extractor
from elf_runtime.extraction.frames import Clip, Frame, Still
from elf_runtime.extraction.overlap import overlapped
from elf_runtime.extraction.room import LARGE, memory_needed
from elf_runtime.extraction.store import is_url
from elf_runtime.image.video import VIDEO_SUFFIXES

from . import command, detect_ray, options
from .command import UsageError
from .cores import opencv_threads, shared_cores
from .detect_options import build_parser
from .detect_report import Run, lines_of, record_of
from .inputs import check_pictures, image_files, settled, video_files
from .outputs import check_outputs
from .patience import Patience
from .progress import Progress

GOES_ON = "what is done stays, and --skip-existing goes on from there"


def main(argv: Sequence[str] | None = None) -> int:
    return command.run(build_parser(), _work, argv, GOES_ON)


def _work(args: argparse.Namespace) -> int:
    if args.engine == "ray":
        return detect_ray.work(args)
    _refuse_urls(args)
    stills, clips = _inputs(args)
    counts = [1] * len(stills) + [clip.count() for clip in clips]
    total = None if None in counts else sum(count or 0 for count in counts)
    endings = ["npz", "csv"]
    if args.picture or (args.picture is None and total == 1 and stills):
        endings.append("png")
    if args.explain:
        endings.append("explain.png")
    _check(args, stills, endings)
    elf, workers = _opened(args, stills, total)
    extract = _extractor(elf, args, endings)
    # The summary alone goes to standard output where it is asked for there.
    to_stdout = "-" in (args.json, args.jsonl)
    progress = Progress("elf-detect", "image", total, sys.stderr if to_stdout else sys.stdout, args.quiet)
    run = Run(args, extract.params, extract.mask is not None, progress)
    frames: Iterator[Frame] = chain(stills, *(clip.frames() for clip in clips))
    with ExitStack() as stack:
        stack.callback(progress.close)
        stack.enter_context(opencv_threads(1 if workers > 1 else None))
        lines = stack.enter_context(lines_of(args.jsonl)) if args.jsonl else None
        first = str(stills[0].path) if stills else "the first frame"
        patience = stack.enter_context(Patience(f"elf-detect: {first} takes a while ...", args.quiet))
        for _, result in overlapped(extract, frames, workers, alone=lambda frame: frame.stem):
            patience.over()
            run.take(result, lines)
    run.finish(elf)
    return command.FAILED if run.failed else 0


def _inputs(args: argparse.Namespace) -> tuple[list[Still], list[Clip]]:
    """The image files and the videos that the command line names, each with the place of its results."""
    videos = [word for word in args.images if Path(word).suffix.lower() in VIDEO_SUFFIXES and not os.path.isdir(word)]
    words = [word for word in args.images if word not in videos]
    if not args.images and args.camera is None:
        raise UsageError("nothing to detect in: give images, folders, patterns or videos, or --camera 0")
    if not videos and args.camera is None and (args.every != 1 or args.limit is not None):
        raise UsageError("--every and --limit are for videos and --camera")
    found = image_files(words, args.recursive, args.base) if words else {}
    stills = [Still(path, args.output / settled(path, name, args.output)) for path, name in found.items()]
    wanted = {"every": args.every, "limit": args.limit, "ignore_exif": args.ignore_exif, "max_pixels": args.max_pixels}
    clips = [Clip(path, args.output / name, **wanted) for path, name in video_files(videos, args.base).items()]
    if args.camera is not None:
        clips.append(Clip(args.camera, args.output / f"camera{args.camera}", **wanted))
    return stills, clips


def _refuse_urls(args: argparse.Namespace) -> None:
    """What this engine can't do, said before anything is looked for."""
    if url := next((place for place in (args.output, args.base, *args.images) if is_url(place)), None):
        raise UsageError(f"{url}: images and outputs elsewhere are for --engine ray")
    if args.format is not None or args.shard_size is not None:
        raise UsageError("--format and --shard-size are for --engine ray")


def _opened(args: argparse.Namespace, stills: Sequence[Still], total: int | None) -> tuple[ElfRuntime, int]:
    """The model, and how many images there are to be at once; the cores are shared by the first image's size."""
    given = args.threads
    workers, args.threads = shared_cores(args.workers, given, total)
    elf = options.open_runtime(args)
    size = stills[0].size() if stills and workers > 1 else None
    if size is not None and memory_needed(size, options.params(elf, args)) > LARGE:
        workers, args.threads = shared_cores(args.workers, given, total, large=True)
        elf = options.open_runtime(args)
    return elf, workers


def _check(args: argparse.Namespace, stills: Sequence[Still], endings: Sequence[str]) -> None:
    """Refuse outputs that can't be written, or that cost another file, before any work."""
    if args.json == args.jsonl == "-":
        raise UsageError("--json - and --jsonl - can't both have standard output")
    # Two images of one name: the second finds the first's results there.
    written = [Path(f"{stem}.{ending}") for stem in dict.fromkeys(s.stem for s in stills) for ending in endings]
    paths: list[str | Path | None] = [still.path for still in stills]
    check_outputs(
        {"-o": written, "--json": [args.json], "--jsonl": [args.jsonl]},
        {"an input image": [*paths, *args.images], "the mask": [args.mask], "the model": [args.model]},
        made=args.output,
    )
    if endings[-1].endswith("png"):
        check_pictures(args.images, [still.path for still in stills], args.output, args.recursive)


def _extractor(elf: ElfRuntime, args: argparse.Namespace, endings: Sequence[str]) -> Extractor:
    mask = options.read_mask(args)
    return Extractor(
        elf, options.params(elf, args), args.descriptor, mask, endings, record_of(elf, args, mask),
        ignore_exif=args.ignore_exif, max_pixels=args.max_pixels,
        skip_existing=args.skip_existing, overwrite=args.overwrite,
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
