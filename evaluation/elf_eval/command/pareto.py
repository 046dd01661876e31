"""``elf-eval pareto``: time against matching score."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from elf_eval.bench.measurement import Timing, measure
from elf_eval.bench.pareto import Study
from elf_eval.errors import EvalError
from elf_eval.report import pareto, plots
from elf_eval.run.results import Results
from elf_eval.suite.suite import Suite
from elf_runtime.commands.options import positive
from elf_runtime.files.write import unwritable

from .options import Subcommands
from .outputs import check_folder


def add_parser(commands: Subcommands) -> None:
    parser = commands.add_parser("pareto", help="time against matching score: a table and a picture with the front")
    parser.add_argument("suite", help="TOML file: the methods to time; [groups] of scenes for a second table")
    parser.add_argument("results", help="results.json of elf-eval run with that suite: the quality")
    parser.add_argument("--image", required=True, help="photograph to time on, resized as the datasets' images are")
    parser.add_argument("--out", required=True, help="FOLDER/NAME: writes NAME.json, NAME.md and NAME.png")
    parser.add_argument("--picture", help="another place for the picture")
    parser.add_argument("--reference", default="SIFT", help="what the ratios of times are to (%(default)s)")
    parser.add_argument("--repeats", type=positive, default=10, help="interleaved repetitions (%(default)s)")
    parser.add_argument("--warmup", type=positive, default=2, help="rounds before (%(default)s)")
    parser.add_argument("--threads", type=positive, default=2, help="of each method (%(default)s)")
    parser.add_argument("--redraw", action="store_true", help="page and picture from NAME.json, nothing is timed")
    parser.set_defaults(action=_pareto)


def _pareto(args: argparse.Namespace) -> None:
    out = Path(args.out)
    data, page = out.with_name(f"{out.name}.json"), out.with_name(f"{out.name}.md")
    picture = Path(args.picture) if args.picture else out.with_name(f"{out.name}.png")
    check_folder(out.parent)
    if args.picture and (reason := unwritable(picture.parent)):
        raise EvalError(f"--picture: {reason}")
    if args.redraw:
        study = Study.load(data)
    else:
        timing = Timing(Path(args.image), args.reference, args.repeats, args.warmup, args.threads)
        study = measure(Suite.load(Path(args.suite)), Results.load(Path(args.results)), timing)
        out.parent.mkdir(parents=True, exist_ok=True)
        study.save(data)
    written = [data, page]
    if plots.available():
        pareto.draw(study, picture)
        written.append(picture)
    shown = Path(os.path.relpath(picture, page.parent)).as_posix() if picture.exists() else None
    page.write_text(pareto.markdown(study, shown), encoding="utf-8")
    print(page.read_text(encoding="utf-8"))
    print(f"written: {', '.join(map(str, written))}", file=sys.stderr)
