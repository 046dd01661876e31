"""elf-view: a web page of images with their keypoints, on which settings can be tried."""

from __future__ import annotations

import argparse
import sys
import webbrowser
from collections.abc import Iterator, Sequence
from pathlib import Path

from elf_runtime.engine import ElfRuntime
from elf_runtime.errors import ElfError, printable
from elf_runtime.view.page import is_page, write_page
from elf_runtime.view.results import of_result
from elf_runtime.view.shown import Shown, detected

from . import command, options
from .command import UsageError
from .inputs import image_files
from .outputs import check_outputs
from .parser import Parser, new_parser
from .progress import Progress

DESCRIPTION = """\
Write a web page of a folder's images with their keypoints, and open it in any browser: one file, which needs no server
and loads nothing.

FOLDER has results of elf-detect (.npz, in its subfolders too), or else images, in which it detects as elf-detect would.
On the page, level, count and nms_radius can be changed: keypoints are sought again in the score map, as the runtime
does.  Pointing at a keypoint shows its best match in the other image.  A result is sought again in its image if that is
where it was, and made by the same model; otherwise the page shows the keypoints of the file, and says why.
Several working scales, or a grid, are shown as they were detected.

Pictures are JPEGs of at most 1600 pixels, maps are in 16 bits, and at most 3000 keypoints of an image have descriptors,
in 8 bits: roughly half a megabyte to two for an image.  The page keeps two images in memory at a time."""

EPILOG = """\
examples:
  elf-view photos/ -o view.html --open
  elf-detect photos/ -o out/ && elf-view out/
  elf-view photos/ -r --preset accurate --max-keypoints 1000 -o accurate.html

exit status: 0 if the page was written, 1 if an image or a result can't be read, 2 on a wrong command line"""


def build_parser() -> Parser:
    parser = new_parser("elf-view", DESCRIPTION, EPILOG)
    parser.add_argument("folder", metavar="FOLDER", help="folder of results of elf-detect, or of images")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("view.html"), metavar="FILE",
        help="the page, whose folder is made; default: view.html. Only a page of elf-view is overwritten",
    )  # fmt: skip
    parser.add_argument("-r", "--recursive", action="store_true", help="take the images in subfolders too")
    parser.add_argument("--open", action="store_true", help="open the page in the browser")
    options.add_quiet(parser)
    options.add_image_options(parser)
    options.add_detection_options(parser)
    options.add_model_options(parser)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    return command.run(build_parser(), _work, argv)


def _work(args: argparse.Namespace) -> int:
    folder = Path(args.folder)
    if not folder.is_dir():
        raise ElfError(f"{folder}: " + ("not a folder" if folder.exists() else "there is no such folder"))
    paths, are_results = _inputs(folder, args)
    _check_output(args.output, paths)
    elf = options.open_runtime(args)
    args.output.parent.mkdir(parents=True, exist_ok=True)
    progress = Progress("elf-view", "image", len(paths), sys.stdout, args.quiet)
    try:
        write_page(
            args.output, f"ELF keypoints: {folder.resolve().name}", _shown(elf, paths, are_results, args, progress)
        )
    finally:
        progress.close()
    megabytes = args.output.stat().st_size / 1e6
    progress.close(printable(f"{len(paths)} images -> {args.output}, {megabytes:.1f} MB"))
    if args.open and not webbrowser.open(args.output.resolve().as_uri()):
        raise ElfError(f"{args.output} is written, and no browser could be started to show it")
    return 0


def _inputs(folder: Path, args: argparse.Namespace) -> tuple[list[Path], bool]:
    """The results of the folder, or its images; and whether they are results."""
    found = sorted(path for path in folder.rglob("*.npz") if not _is_hidden(path.relative_to(folder)))
    if not found:
        try:
            return list(image_files([str(folder)], args.recursive)), False
        except UsageError as error:
            raise UsageError(f"{error}, and no results of elf-detect (.npz)") from error
    given = sorted(name for name, value in options.settings(args).items() if value is not None)
    if given:
        raise UsageError(
            f"{folder} has results, whose settings are those that they were made with: leave out {given[0]}"
        )
    return found, True


def _is_hidden(path: Path) -> bool:
    return any(part.startswith(".") for part in path.parts)


def _check_output(output: Path, paths: Sequence[Path]) -> None:
    """Refuse to write what is no page, or over what is none."""
    if output.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"-o {output}: the page is an .html file")
    check_outputs({"-o": [output]}, {"an input": list(paths)}, made=output.parent)
    if output.exists() and not is_page(output):
        raise UsageError(f"-o {output}: this file is no page of elf-view; give another name")


def _shown(
    elf: ElfRuntime, paths: Sequence[Path], are_results: bool, args: argparse.Namespace, progress: Progress
) -> Iterator[Shown]:
    """The images one after the other, so that one of them is in memory at a time."""
    folder = Path(args.folder)
    for path in paths:
        name = str(path.relative_to(folder))
        if are_results:
            image = of_result(elf, path, name.removesuffix(".npz"))
        else:
            image = detected(elf, name, options.read_image(path, args), options.params(elf, args), args.descriptor)
        note = f": {image.note}" if image.note else ""
        progress.done(printable(f"{name}{note}"))
        yield image


if __name__ == "__main__":
    sys.exit(main())
