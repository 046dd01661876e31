"""``elf-eval list``: the kinds of datasets and methods."""

from __future__ import annotations

import argparse

import cv2

from elf_eval.data import DATASETS
from elf_eval.methods import METHODS
from elf_eval.methods.opencv import OPENCV, installed

from .options import Subcommands


def add_parser(commands: Subcommands) -> None:
    parser = commands.add_parser("list", help="kinds of datasets and methods")
    parser.set_defaults(action=_list)


def _list(_: argparse.Namespace) -> None:
    here = [kind for kind in OPENCV if installed(kind)]
    missing = [kind for kind in OPENCV if kind not in here]
    print(f"datasets: {', '.join(DATASETS)}")
    print(f"methods:  {', '.join(kind for kind in METHODS if kind not in OPENCV)}, plugin:module.function")
    print(f"OpenCV {cv2.__version__}: {', '.join(here)}; not in this build: {', '.join(missing) or 'none'}")
