"""elf-detect: keypoints and descriptors of images, videos and cameras, as files and pictures."""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from itertools import chain
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from elf_runtime.engine import ElfRuntime
from elf_runtime.errors import printable
from elf_runtime.extraction.extractor import Extractor
from elf_runtime.extraction.frames import Clip, Frame, Still
from elf_runtime.extraction.overlap import overlapped
from elf_runtime.extraction.room import LARGE, memory_needed
from elf_runtime.image.video import VIDEO_SUFFIXES

from . import command, options
from .command import UsageError
from .cores import opencv_threads, shared_cores
from .detect_options import build_parser
from .inputs import check_pictures, image_files, video_files
from .outputs import check_outputs
from .progress import Progress

GOES_ON = "what is done stays, and --skip-existing goes on from there"


def main(argv: Sequence[str] | None = None) -> int:
    return command.run(build_parser(), _work, argv, GOES_ON)


def _work(args: argparse.Namespace) -> int:
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
    run = _Run(args, extract, progress)
    frames: Iterator[Frame] = chain(stills, *(clip.frames() for clip in clips))
    with ExitStack() as stack:
        stack.callback(progress.close)
        stack.enter_context(opencv_threads(1 if workers > 1 else None))
        lines = stack.enter_context(_lines(args.jsonl)) if args.jsonl else None
        for _, result in overlapped(extract, frames, workers, alone=lambda frame: frame.stem):
            run.take(result, lines)
    run.finish(elf)
    return command.FAILED if run.failed else 0


def _inputs(args: argparse.Namespace) -> tuple[list[Still], list[Clip]]:
    """The image files and the videos that the command line names, each with the place of its results."""
    videos = [word for word in args.images if Path(word).suffix.lower() in VIDEO_SUFFIXES and not Path(word).is_dir()]
    words = [word for word in args.images if word not in videos]
    if not args.images and args.camera is None:
        raise UsageError("nothing to detect in: give images, folders, patterns or videos, or --camera 0")
    if not videos and args.camera is None and (args.every != 1 or args.limit is not None):
        raise UsageError("--every and --limit are for videos and --camera")
    found = image_files(words, args.recursive, args.base) if words else {}
    stills = [Still(path, args.output / name) for path, name in found.items()]
    wanted = {"every": args.every, "limit": args.limit, "ignore_exif": args.ignore_exif, "max_pixels": args.max_pixels}
    clips = [Clip(path, args.output / name, **wanted) for path, name in video_files(videos, args.base).items()]
    if args.camera is not None:
        clips.append(Clip(args.camera, args.output / f"camera{args.camera}", **wanted))
    return stills, clips


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
    origin = options.origin(elf, args)
    kept = ("model_sha256", "network", "layer", "descriptor", "settings")
    record = {name: origin[name] for name in kept} | {"ignore_exif": args.ignore_exif}
    if mask is not None:
        record["mask_sha256"] = hashlib.sha256(np.packbits(mask).tobytes()).hexdigest()
    return Extractor(
        elf, options.params(elf, args), args.descriptor, mask, endings, record,
        ignore_exif=args.ignore_exif, max_pixels=args.max_pixels,
        skip_existing=args.skip_existing, overwrite=args.overwrite,
    )  # fmt: skip


class _Run:
    """What became of the images, as it is reported."""

    def __init__(self, args: argparse.Namespace, extract: Extractor, progress: Progress) -> None:
        self._args, self._extract, self._progress = args, extract, progress
        self._start = time.perf_counter()
        self._asked = args.max_keypoints is not None or "max_keypoints" in dict(args.set)
        self._images: list[Mapping[str, Any]] = []  # for --json only: a long run is not kept in memory
        self.failed: list[str] = []
        self._done = self._skipped = 0

    def take(self, result: Mapping[str, Any], lines: TextIO | None) -> None:
        if "error" in result:
            self.failed.append(result["error"])
            self._progress.failed(result["error"])
            self._progress.advance()
        else:
            self._done += 1
            self._skipped += result["skipped"]
            self._progress.done(self._line(result))
        if lines is not None:
            lines.write(json.dumps(result) + "\n")
            lines.flush()
        if self._args.json:
            self._images.append(result)

    def finish(self, elf: ElfRuntime) -> None:
        """The last line, the failures once more where many lines lie between, and the summary."""
        count, seconds = self._done + len(self.failed), time.perf_counter() - self._start
        text = ""
        if count > 1:
            parts = [f"{count} images in {seconds:.1f} s, {count / seconds:.1f} a second"]
            parts += [f"{self._skipped} skipped"] if self._skipped else []
            parts += [f"{len(self.failed)} failed" + ("" if self._args.quiet else ":")] if self.failed else []
            text = "\n".join([", ".join(parts), *(f"  {error}" for error in self.failed)])
        self._progress.close(text)
        if self._args.json:
            command.write_json(self._args.json, {**options.origin(elf, self._args), "images": self._images})

    def _line(self, result: Mapping[str, Any]) -> str:
        """What is said of an image that is done."""
        first, *others = result["files"]
        files = ", ".join([first, *(file.removeprefix(first.removesuffix(".npz")) for file in others)])
        name = result["image"] + (f", frame {result['frame']}" if "frame" in result else "")
        if result["skipped"]:
            return printable(f"{name}: skipped, {files} are of these pixels, model and settings")
        height, width = result["size"]
        count = f"{result['keypoints']} keypoints{self._why_fewer(result['keypoints'])}"
        return printable(f"{name}: {count}, {width}x{height}, {result['seconds']:.2f} s -> {files}")

    def _why_fewer(self, count: int) -> str:
        """Why there are fewer keypoints than the user asked for; empty where there are not."""
        params = self._extract.params
        if not self._asked or count >= params.max_keypoints:
            return ""
        masked = " and the mask" if self._extract.mask is not None else ""
        limit = "there are" if params.threshold == "none" else f"the threshold (--threshold){masked} let through"
        return f" of {params.max_keypoints} asked for: {limit} no more"


def _lines(target: str) -> AbstractContextManager[TextIO]:
    """The stream of --jsonl, whose file's folder is made."""
    if target == "-":
        return nullcontext(sys.stdout)
    Path(target).parent.mkdir(parents=True, exist_ok=True)
    return open(target, "w", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
