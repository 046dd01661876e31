"""``elf-eval depth``: depth maps for the 3D protocol, from cameras alone."""

from __future__ import annotations

import argparse
from pathlib import Path

from elf_eval.data import open_dataset
from elf_eval.data.plane_sweep import PLANES
from elf_eval.run.depth_maps import WITHIN, depth_maps, save
from elf_eval.run.workers import set_threads
from elf_runtime.commands.options import positive

from .options import Subcommands, add_out
from .outputs import check_folder


def add_parser(commands: Subcommands) -> None:
    parser = commands.add_parser("depth", help="depth maps of images whose cameras are known, by a sweep of planes")
    parser.add_argument("dataset", help="kind:FOLDER[?option=value&...], with poses: strecha, colmap, pairs")
    parser.add_argument("--side", type=positive, default=768, help="pixels of the longer side (%(default)s)")
    parser.add_argument("--planes", type=_planes, default=PLANES, help="depths that are tried (%(default)s)")
    parser.add_argument("--threads", type=positive, help="all cores")
    parser.add_argument("-q", "--quiet", action="store_true", help="no progress lines")
    add_out(
        parser, "writes SCENE/STEM.depth.npy; strecha:FOLDER reads it there, strecha:...?depth=FOLDER from elsewhere"
    )
    parser.set_defaults(action=_depth)


def _depth(args: argparse.Namespace) -> None:
    out, dataset = Path(args.out), open_dataset(args.dataset)
    check_folder(out)
    set_threads(args.threads)
    print(f"kept is what a neighbour's map agrees with to {100 * WITHIN:g} % of the depth")
    for found in depth_maps(dataset, args.side, args.planes, args.quiet):
        path = save(found, out)
        print(f"{path}: {100 * found.known:.0f} % of the pixels; median difference {100 * found.difference:.2f} %")


def _planes(text: str) -> int:
    """Three or more: a depth is refined between a plane's two neighbours."""
    if (count := positive(text)) < 3:
        raise argparse.ArgumentTypeError(f"{text} planes are too few; take 3 or more")
    return count
