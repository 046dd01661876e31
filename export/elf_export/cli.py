"""`elf-export`: a CNN in, an ELF model (one .onnx file) out."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from elf_export.errors import ExportError
from elf_export.request import Log
from elf_runtime.commands.command import run
from elf_runtime.errors import printable

from .command.asked import request_of
from .command.combinations import check
from .command.options import parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status (0 done, 1 failed, 2 wrong usage, 130 interrupted)."""
    p = parser()

    def work(args: argparse.Namespace) -> int:
        check(args, p.error)
        _need_onnx(next((f"--{name}" for name in ("match", "elf", "onnx") if getattr(args, name)), "--net"))
        (_match if args.match else _list if args.list else _export)(args)
        return 0

    return run(p, work, argv)


def _need_onnx(option: str) -> None:
    """Refuse to go on without the onnx package; --net needs PyTorch too."""
    try:
        import onnx  # noqa: F401
    except ImportError as error:
        if error.name != "onnx":
            raise ExportError(f"the package onnx is installed but can't be loaded: {error}") from error
        if option == "--net":
            raise ExportError(
                "named networks need PyTorch and onnx: pip install torch (the CPU build is enough), then pip install "
                '".[export]"'
            ) from error
        raise ExportError(f"elf-export {option} needs the package onnx, and no PyTorch: pip install onnx") from error


def _export(args: argparse.Namespace) -> None:
    from elf_export.pipeline import export

    from .command.finished import finished

    log: Log = _silent if args.quiet else print
    result = finished(args, log) if args.elf else export(request_of(args), log)
    size, contract = result.path.stat().st_size / 1e6, result.contract
    described = ", ".join(d.layer for d in contract.descriptors) or "none"
    made = f"{contract.network} {contract.layer}, descriptors {described}"
    log(printable(f"wrote {result.path} ({size:.1f} MB): {made}"))


def _match(args: argparse.Namespace) -> None:
    from elf_export.end_to_end.match import match_graph
    from elf_export.file import check_output, write

    path = check_output(args.output or "elf-match.onnx", args.force)
    write(match_graph(), None, path)
    if not args.quiet:
        size = path.stat().st_size / 1e3
        print(printable(f"wrote {path} ({size:.1f} kB): the descriptors of two images in, matches out"))


def _silent(_: str) -> None:
    pass


def _list(args: argparse.Namespace) -> None:
    from elf_export.sources.networks import get_network, network_names

    from .command.listing import network_table

    if args.onnx is not None:
        from .command.listing_onnx import model_table

        print(model_table(args.onnx, args.input))
    elif args.net is not None:
        print(network_table(get_network(args.net)))
    else:
        for name in network_names():
            network = get_network(name)
            described = ",".join(network.default_descriptors) or "none"
            print(f"{name:<20}{network.title}; default --layer {network.default_layer} --desc {described}")


if __name__ == "__main__":
    sys.exit(main())
