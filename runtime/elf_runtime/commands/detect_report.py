"""What elf-detect tells of a run, whichever engine did it."""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import numpy.typing as npt

from elf_runtime.engine import ElfRuntime
from elf_runtime.errors import printable
from elf_runtime.params import DetectionParams

from . import command, options
from .progress import Progress


class Run:
    """What became of the images, as it is reported.

    Parameters
    ----------
    args : argparse.Namespace
    params : DetectionParams
    masked : bool
        Whether there is a mask.
    progress : Progress
    """

    def __init__(self, args: argparse.Namespace, params: DetectionParams, masked: bool, progress: Progress) -> None:
        self._args, self._params, self._masked, self._progress = args, params, masked, progress
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
        params = self._params
        if not self._asked or count >= params.max_keypoints:
            return ""
        masked = " and the mask" if self._masked else ""
        limit = "there are" if params.threshold == "none" else f"the threshold (--threshold){masked} let through"
        return f" of {params.max_keypoints} asked for: {limit} no more"


def lines_of(target: str) -> AbstractContextManager[TextIO]:
    """The stream of --jsonl, whose file's folder is made."""
    if target == "-":
        return nullcontext(sys.stdout)
    Path(target).parent.mkdir(parents=True, exist_ok=True)
    return open(target, "w", encoding="utf-8")


def record_of(elf: ElfRuntime, args: argparse.Namespace, mask: npt.NDArray[np.bool_] | None) -> dict[str, Any]:
    """What results say of model and settings, by which a later run knows them again."""
    origin = options.origin(elf, args)
    kept = ("model_sha256", "network", "layer", "descriptor", "settings")
    record = {name: origin[name] for name in kept} | {"ignore_exif": args.ignore_exif}
    if mask is not None:
        record["mask_sha256"] = hashlib.sha256(np.packbits(mask).tobytes()).hexdigest()
    return record
