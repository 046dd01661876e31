"""``elf-eval images``: a dataset's images as they are evaluated, for another program's features."""

from __future__ import annotations

import argparse
from pathlib import Path

from elf_eval.data import open_dataset
from elf_eval.data.images import written_name
from elf_eval.protocol import Protocol
from elf_runtime.pictures.file import write_picture

from .options import Subcommands, add_out, image_size, protocol
from .outputs import check_folder


def add_parser(commands: Subcommands) -> None:
    parser = commands.add_parser("images", help="write a dataset's images as evaluated, for another program's features")
    parser.add_argument("dataset", help="kind:FOLDER[?option=value&...]")
    add_out(parser, "folder of the images; each gets its name in the dataset, as .png")
    parser.add_argument("--size", type=image_size, help="WIDTHxHEIGHT or source")
    parser.set_defaults(action=_images)


def _images(args: argparse.Namespace) -> None:
    out, size = Path(args.out), protocol(args, Protocol()).size
    refs = list(open_dataset(args.dataset).images())
    check_folder(out)
    for ref in refs:
        path = out / written_name(ref.name)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_picture(path, ref.open(size).pixels)
    print(f"{len(refs)} images in {out}")
