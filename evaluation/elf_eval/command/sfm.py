"""``elf-eval sfm``: structure from motion from few images of a scene, against the poses of all."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from elf_eval.report.sfm import sfm_page
from elf_eval.run.sfm_study import study
from elf_runtime.commands.options import positive

from .by_hand import add_by_hand, is_by_hand, load, suite_by_hand
from .options import Subcommands, add_out, add_protocol, add_resources, natural, protocol, resources
from .outputs import check_folder, say_written


def add_parser(commands: Subcommands) -> None:
    parser = commands.add_parser("sfm", help="structure from motion from few images, against the poses of all")
    parser.add_argument("suite", nargs="*", help="a TOML file: methods, datasets, protocol")
    add_by_hand(parser)
    parser.add_argument(
        "--sizes", type=_sizes, default=[3, 5, 10, 25], help="comma-separated numbers of images (3,5,10,25)"
    )
    parser.add_argument("--subsets", type=positive, default=10, help="of each size and scene (%(default)s)")
    parser.add_argument("--seed", type=natural, default=0, help="of the draw (%(default)s)")
    add_out(parser, "folder of the results")
    add_protocol(parser, scores=False)
    add_resources(parser)
    parser.set_defaults(action=_sfm)


def _sfm(args: argparse.Namespace) -> None:
    out = Path(args.out)
    check_folder(out)
    suites = [suite_by_hand(args)] if is_by_hand(args) else [load(Path(path), args) for path in args.suite]
    for path, suite in zip(args.suite or [""], suites, strict=True):
        folder = out / Path(path).stem if path else out
        found = study(suite, args.sizes, args.subsets, args.seed, resources(args))
        title = "Structure from motion from few images" if not path else f"{suite.title}: structure from motion"
        page = sfm_page(found, title, suite.note, protocol(args, suite.protocol), args.command_line)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "sfm.md").write_text(page, encoding="utf-8")
        (folder / "sfm.json").write_text(json.dumps(found.to_json(), indent=1), encoding="utf-8")
        print(page)
        say_written(folder, ["sfm.md", "sfm.json"])


def _sizes(text: str) -> list[int]:
    sizes = [natural(part) for part in text.split(",")]
    if min(sizes) < 2:
        raise argparse.ArgumentTypeError("a reconstruction is of 2 images or more")
    return list(dict.fromkeys(sizes))
