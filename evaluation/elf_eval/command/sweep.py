"""``elf-eval sweep``: settings that are chosen on some scenes and reported on the others."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from elf_eval.protocol import Protocol
from elf_eval.report.sweep import sweep_json, sweep_table
from elf_eval.run.sweep import sweep
from elf_eval.suite.grid import grid_methods, parse_grid
from elf_runtime.commands.options import positive

from .options import Subcommands, add_out, add_protocol, add_resources, natural, protocol, resources
from .outputs import check_folder, say_written


def add_parser(commands: Subcommands) -> None:
    parser = commands.add_parser("sweep", help="choose settings on some scenes, report on the others")
    parser.add_argument(
        "--model", action="append", required=True, help="elf:FILE.onnx[?...]; one for each layer to try"
    )
    parser.add_argument(
        "--grid",
        action="append",
        default=[],
        help="SETTING=VALUE/VALUE/..., e.g. denoise=5,5/5,2; ranges are FROM..TO[..STEP]: denoise=3..21..2,4..13",
    )
    parser.add_argument("--dataset", required=True, help="kind:FOLDER[?option=value&...]")
    parser.add_argument("--tune", help="comma-separated scenes to choose on; by default every second one")
    parser.add_argument(
        "--beside",
        action="append",
        default=[],
        help="reported with the best but not chosen from: elf:FILE.onnx?preset=paper; may be repeated",
    )
    parser.add_argument("--metric", default="ms", help="what to choose by (%(default)s)")
    parser.add_argument("--top", type=positive, default=5, help="report so many (%(default)s)")
    parser.add_argument("--limit", type=positive, help="try only so many settings, drawn at random")
    parser.add_argument("--seed", type=natural, default=0, help="of the draw (%(default)s)")
    add_out(parser, "folder of what is printed, and of sweep.json with the command and protocol", required=False)
    add_protocol(parser)
    add_resources(parser)
    parser.set_defaults(action=_sweep)


def _sweep(args: argparse.Namespace) -> None:
    texts = grid_methods(args.model, parse_grid(args.grid), args.limit, args.seed)
    tune = args.tune.split(",") if args.tune else None
    settings, out = protocol(args, Protocol()), Path(args.out) if args.out else None
    if out is not None:
        check_folder(out)
    found = sweep(texts, args.dataset, args.metric, args.top, settings, resources(args), tune, args.beside)
    table = f"{len(texts)} settings; the last line is the reference of the gain\n{sweep_table(found, args.metric)}"
    print(table)
    if out is not None:
        about = {"command": args.command_line, "dataset": args.dataset, "metric": args.metric, "settings": len(texts)}
        about |= {"protocol": settings.to_dict(), "trials": sweep_json(found)}
        out.mkdir(parents=True, exist_ok=True)
        (out / "sweep.txt").write_text(f"{table}\n", encoding="utf-8")
        (out / "sweep.json").write_text(json.dumps(about, indent=1), encoding="utf-8")
        say_written(out, ["sweep.txt", "sweep.json"])
