"""The pairs of elf-match, one after another: matched, said, and written where that is asked for."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from elf_runtime.errors import ElfError, SettingError, printable, reason
from elf_runtime.files.write import real
from elf_runtime.geometry.cameras import Cameras
from elf_runtime.geometry.fit import Search, fit
from elf_runtime.geometry.refine import refine
from elf_runtime.results.features import Array
from elf_runtime.results.matches import Matches
from elf_runtime.results.matching import match

from . import command
from .match_pairs import Plan, file_stem
from .match_report import Matched, single_document
from .match_views import Views
from .progress import Progress


class Run:
    """The pairs of one command line."""

    def __init__(self, args: argparse.Namespace, wanted: Plan, views: Views) -> None:
        self._args, self._plan, self._views = args, wanted, views
        # The JSON alone goes to standard output where it is asked for there.
        self._stream = sys.stderr if args.json == "-" else sys.stdout
        self._settings = {
            "ratio": args.ratio,
            "refine": args.refine,
            "ransac": args.ransac,
            "ransac_threshold": args.ransac_threshold if args.ransac else None,
        }
        self._progress = self._counting("pair", 1)
        self._said: dict[str, None] = {}  # in order
        self._taken = {real(path) for path in wanted.paths}

    def single(self) -> int:
        """Two images: what is wrong ends the run."""
        names, args = self._plan.names, self._args
        matched = self._matched(0, 1)
        written = self._write(matched, 0, 1, args.output, args.save)
        counts = [f"{name}: {self._views.about(i)['keypoints']} keypoints" for i, name in enumerate(names)]
        self._say(f"{counts[0]}, {counts[1]}, {matched.counts()}{matched.more()}", written)
        if args.json:
            about = [self._views.about(i) | {"image": name} for i, name in enumerate(names)]
            command.write_json(args.json, single_document(about, self._views.origin, self._settings, matched))
        return 0

    def many(self) -> int:
        """Pairs of a folder: one that fails is reported, and the others go on."""
        for folder in (self._args.output, self._args.save):
            if folder is not None:
                folder.mkdir(parents=True, exist_ok=True)
        self._detect()
        start = time.perf_counter()
        nearest = self._plan.pairs is None
        chosen = self._views.nearest(self._plan.nearest, self._plan.query) if nearest else self._plan.pairs or []
        self._progress = self._counting("pair", len(chosen))
        try:
            pairs = [self._pair(i, j) for i, j in chosen]
        finally:
            self._progress.close()
        failed = [i for i in range(len(self._plan.paths)) if self._views.has_failed(i)]
        for i in failed:
            self._report(self._views.about(i)["error"])
        shut = [{"image": str(folder), "error": f"{folder}: {why}"} for folder, why in self._plan.shut.items()]
        for folder in shut:
            self._report(folder["error"])
        self._progress.close(self._summary(pairs, time.perf_counter() - start))
        if self._args.json:
            images = [*(self._views.about(i) for i in range(len(self._plan.paths))), *shut]
            origin = {**self._views.origin, "pairs_by": self._args.pairs or "exhaustive", **self._settings}
            command.write_json(self._args.json, {"images": images, **origin, "pairs": pairs})
        return command.FAILED if failed or shut or any("error" in pair for pair in pairs) else 0

    def _counting(self, unit: str, total: int) -> Progress:
        return Progress("elf-match", unit, total, self._stream, self._args.quiet)

    def _detect(self) -> None:
        images = self._counting("image", self._views.images)
        try:
            self._views.detect_all(images.step)
        finally:
            images.close()

    def _summary(self, pairs: Sequence[Mapping[str, Any]], seconds: float) -> str:
        """The last line, and the failures once more where there are any, as elf-detect's."""
        if len(pairs) + len(self._said) < 2:
            return ""
        parts = [f"{len(pairs)} pairs in {seconds:.1f} s"]
        if failed := sum("error" in pair for pair in pairs):
            parts.append(f"{failed} failed")
        elif self._said:
            what = "images and folders" if self._plan.shut else "images"
            parts.append(f"{len(self._said)} of the {what} left out")
        errors = [] if self._args.quiet else self._said
        return "\n".join([", ".join(parts) + (":" if errors else ""), *(f"  {error}" for error in errors)])

    def _pair(self, i: int, j: int) -> dict[str, Any]:
        """Match a pair and write what is asked for; what the JSON says of it."""
        one, two = self._plan.names[i], self._plan.names[j]
        about: dict[str, Any] = {"a": str(self._plan.paths[i]), "b": str(self._plan.paths[j])}
        stem = file_stem(one, two)
        output, save = self._args.output, self._args.save
        try:
            matched = self._matched(i, j)
            written = self._write(matched, i, j, output and output / f"{stem}.png", save and save / f"{stem}.npz")
        except (ElfError, OSError) as error:
            text = str(error)
            if isinstance(error, SettingError):  # what can't be compared is about neither of the two alone
                text = f"{one}, {two}: {error}"
            elif isinstance(error, OSError):
                text = f"{error.filename or one}: {reason(error)}"
            self._report(text)
            self._progress.advance()
            return about | {"error": text}
        self._say(f"{one}, {two}: {matched.counts()}{matched.more()}", written)
        return about | matched.summary()

    def _matched(self, i: int, j: int) -> Matched:
        args, views = self._args, self._views
        first, second = views.features(i), views.features(j)
        pairs = match(first, second, args.ratio)
        points, refined = self._places(i, j, Matches.of(pairs))
        cameras = None
        if args.ransac == "essential":
            cameras = (views.camera(i, args.K), views.camera(j, args.K_b))
        known = None if cameras is None else Cameras.of(list(cameras))
        search = Search("magsac", args.ransac_threshold)
        view = fit(*points, args.ransac, search, known) if args.ransac else None
        return Matched(first, second, pairs, points, refined, view, cameras)

    def _places(self, i: int, j: int, matches: Matches) -> tuple[tuple[Array, Array], int | None]:
        """Where the matches are in the two images, and how many of B's were moved if they are to be refined."""
        views = self._views
        a, b = matches.points(views.features(i), views.features(j))
        if not self._args.refine:
            return (a, b), None
        moved = refine(matches, views.features(i), views.features(j), views.pixels(i), views.pixels(j))
        return (a, moved), int((moved != b).any(axis=1).sum())

    def _write(self, matched: Matched, i: int, j: int, picture: Path | None, arrays: Path | None) -> list[Path]:
        """The files of a pair; of many pairs, none that is an input or another pair's."""
        written = [path for path in (picture, arrays) if path]
        for path in written:
            if not self._plan.single and real(path) in self._taken:
                raise ElfError(f"{path} is an input, or another pair's; give another folder")
            self._taken.add(real(path))
        if picture:
            images = [self._views.pixels(index) for index in (i, j)]
            matched.draw(picture, images, [self._plan.paths[index] for index in (i, j)])
        if arrays:
            matched.save(arrays)
        return written

    def _say(self, text: str, written: Sequence[Path]) -> None:
        files = ", ".join(map(str, written))
        self._progress.found(printable(text + (f" -> {files}" if files else "")))

    def _report(self, text: str) -> None:
        """An error on standard error, once."""
        if text not in self._said:
            self._said[text] = None
            self._progress.failed(text)
