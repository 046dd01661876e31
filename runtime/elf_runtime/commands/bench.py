"""elf-bench: latency, memory and start-up time of a model, beside other detectors in the same run."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2

from elf_runtime.engine import ElfRuntime
from elf_runtime.errors import ModelError
from elf_runtime.image import read
from elf_runtime.params import setting_text
from elf_runtime.pictures.file import write_picture
from elf_runtime.pictures.render import displayable
from elf_runtime.presets import PRESETS
from elf_runtime.timing.environment import environment, usable_cores
from elf_runtime.timing.fresh_process import peak_memory, start_up

from . import command, options
from .bench_sizes import SizeRun, time_in_turn
from .bench_table import table
from .bench_workloads import PEERS, Image, float_model, ours, peers, saliencies, synthetic, torch_peer
from .command import UsageError
from .cores import opencv_threads
from .outputs import check_outputs
from .parser import Parser, add_json, new_parser
from .progress import Progress
from .terminal import say

DESCRIPTION = """\
Time a model stage by stage, beside other detectors where they are installed.

Every repetition runs each contender once, in an order that rotates, so that what slows the machine for a
while slows all of them; several sizes take turns too.  Ratios are medians over the repetitions' pairs, with a
bootstrap interval of 95 %.
Import time, load time and peak memory come from fresh processes.

stages of ELF
  read         the image file decoded (a PNG of the image)
  prepare      to float32 pixels at the working scale
  session      the network: preprocessing, saliency and descriptor map, in ONNX Runtime
  blur         normalisation, and the two Gaussian blurs of the saliency
  threshold    the histogram's level, and what passes it
  nms          non-maximum suppression
  descriptors  the map interpolated at the keypoints, unit length
  post-processing is the last four; detect + describe is all but read, and what the ratios to sift and orb are of"""

EPILOG = """\
peers
  torch        the saliency by torch's autograd in fp32, with the model's weights (needs the extra "export").  The
               bundled int8 model's are in its fp32 twin, whose graph is timed too; --torch-model names another's
  sift, orb    OpenCV's, detectAndCompute on the grey image, at most 500 keypoints"""


def build_parser() -> Parser:
    parser = new_parser("elf-bench", DESCRIPTION, EPILOG)
    parser.add_argument(
        "--sizes",
        type=sizes,
        default=[(480, 640)],
        metavar="HxW,...",
        help="image sizes, height x width; default: 480x640",
    )
    parser.add_argument(
        "--image",
        metavar="FILE",
        help="photograph to resize; default: a synthetic textured image from a fixed seed",
    )
    parser.add_argument("--repeats", type=options.positive, default=20, metavar="N", help="repetitions; default: 20")
    parser.add_argument("--warmup", type=options.positive, default=3, metavar="N", help="rounds before; default: 3")
    parser.add_argument(
        "--processes",
        type=options.positive,
        default=5,
        metavar="N",
        help="fresh processes for start-up; default: 5",
    )
    parser.add_argument(
        "--peers", metavar="NAME,...", help="of torch, sift, orb, or none: detection only; default: those installed"
    )
    parser.add_argument("--torch-model", metavar="FILE", help="ELF model whose weights torch takes; default: --model")
    add_json(parser, "everything, samples included")
    options.add_quiet(parser)
    options.add_model_options(parser)
    parser.add_argument("--preset", choices=PRESETS, help="detection settings; default: the model's own")
    options.add_set_option(parser)
    parser.add_argument(
        "--spin", action="store_true", help="let idle threads spin between runs too: pays where cores are free"
    )
    return parser


def sizes(text: str) -> list[tuple[int, int]]:
    """An argparse type: ``480x640,240x320``."""
    found = []
    for item in text.split(","):
        height, x, width = item.strip().partition("x")
        if not (x and height.isdigit() and width.isdigit() and int(height) and int(width)):
            raise argparse.ArgumentTypeError(f"{item!r} is not HEIGHTxWIDTH")
        found.append((int(height), int(width)))
    return found


def main(argv: Sequence[str] | None = None) -> int:
    return command.run(build_parser(), _work, argv)


def _work(args: argparse.Namespace) -> int:
    wanted = _peer_names(args.peers)
    check_outputs({"--json": [args.json]}, {"the image": [args.image], "a model": [args.model, args.torch_model]})
    args.threads = args.threads or usable_cores()
    elf = _open(args.model, args)
    params = elf.params(args.preset, **dict(args.set))
    maps = elf.contract.end_to_end is None  # else there is no saliency at any scale, to time or to hold against torch's
    least = elf.contract.input.min_size
    for height, width in args.sizes:
        if min(height, width) < least:
            raise UsageError(f"--sizes {height}x{width}: the smallest size of this model is {least}x{least}")
    photo = displayable(read(args.image)) if args.image else None
    report: dict[str, Any] = {
        "model": {"file": args.model or "bundled", "network": elf.contract.network, "layer": elf.contract.layer},
        "preset": args.preset or "default",
        "set": [f"{name}={setting_text(value)}" for name, value in args.set],
        "image": args.image or "synthetic, seed 0",
        "environment": environment(args.threads, elf.providers[0]),
        "repeats": args.repeats,
        "warmup": args.warmup,
        "spin": args.spin,
        "start_up": start_up(args.model, options.provider(args), args.threads, args.processes),
        "sizes": [],
        "peers": {},
    }
    torch_saliency, twin = None, None
    with opencv_threads(args.threads), tempfile.TemporaryDirectory() as folder:
        if "torch" in wanted and not maps:
            if args.peers:
                raise UsageError("--peers torch: the model gives keypoints itself, and has no saliency to compare")
            report["peers"]["torch"] = "the model gives keypoints itself"
        elif "torch" in wanted:
            torch_saliency, twin, report["peers"]["torch"] = _torch(args)
        runs: list[SizeRun] = []
        for height, width in args.sizes:
            image = synthetic(height, width) if photo is None else cv2.resize(photo, (width, height))
            picture = Path(folder) / f"{len(runs)}.png"
            write_picture(picture, image)
            workloads = [ours(elf, picture, params), *(saliencies(elf, twin, image) if wanted and maps else [])]
            runs.append(SizeRun(image, [*workloads, *peers(wanted, image, torch_saliency)]))
        rounds = args.warmup + args.repeats
        if not args.quiet:
            say(f"timing {sum(len(run.workloads) for run in runs)} contenders in {rounds} rounds ...", sys.stderr)
        progress = Progress("elf-bench", "round", rounds, sys.stderr, args.quiet)
        time_in_turn(runs, args.warmup, args.repeats, progress.advance)
        progress.close()
        for run in runs:
            entry = run.entry()
            if torch_saliency is not None:
                entry["saliency_agreement"] = run.agreement(twin or elf, torch_saliency)
            entry["memory"] = peak_memory(args.model, options.provider(args), args.threads, run.image.shape[:2], params)
            report["sizes"].append(entry)
    if not args.quiet:
        say(table(report), sys.stderr if args.json == "-" else None)
    if args.json:
        command.write_json(args.json, report)
    return 0


def _torch(args: argparse.Namespace) -> tuple[Callable[[Image], Any] | None, ElfRuntime | None, str]:
    """The saliency in torch, the model that has the same weights where it is another, and a note on torch."""
    try:
        file = float_model(args.model, args.torch_model)
    except ModelError as error:  # the lean wheel has no model in fp32
        if args.peers:
            raise
        return None, None, str(error)
    saliency, note = torch_peer(file, args.threads)
    if saliency is None and args.peers:
        raise UsageError(f"--peers torch: {note}")
    return saliency, _open(file, args) if saliency is not None and file != args.model else None, note


def _peer_names(text: str | None) -> list[str]:
    names = list(PEERS) if text is None else [] if text == "none" else [n.strip() for n in text.split(",")]
    for name in names:
        if name not in PEERS:
            raise UsageError(f"--peers: unknown peer {name!r}; known are {', '.join(PEERS)}, or none")
    return names


def _open(model: str | None, args: argparse.Namespace) -> ElfRuntime:
    """With a session for every size: they take turns."""
    session = {"providers": options.provider(args), "threads": args.threads, "spin": args.spin or None}
    return ElfRuntime(model, **session, sizes=len(args.sizes))


if __name__ == "__main__":
    sys.exit(main())
