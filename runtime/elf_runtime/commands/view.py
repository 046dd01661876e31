"""elf-view: a web page of images with their keypoints, on which settings can be tried."""

from __future__ import annotations

import argparse
import sys
import webbrowser
from collections.abc import Iterator, Sequence
from pathlib import Path

from elf_runtime.engine import ElfRuntime
from elf_runtime.errors import ElfError, SettingError, printable
from elf_runtime.files.listing import Listing, files_in
from elf_runtime.image.file import image_errors
from elf_runtime.view.page import is_page, write_page
from elf_runtime.view.results import of_result
from elf_runtime.view.shown import Shown, detected

from . import command, options
from .command import UsageError
from .inputs import image_files, images_in
from .outputs import check_outputs
from .parser import Parser, new_parser
from .progress import Progress
from .terminal import say

DESCRIPTION = """\
Write a web page of a folder's images with their keypoints, and open it in any browser: one file, which needs no server
and loads nothing.

FOLDER has images, in which it detects as elf-detect would, or, where it has none, results of elf-detect (.npz, in its
subfolders too).  What can't be read is said, and left out.
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

exit status: 0 if the page was written; 1 if an image or a result can't be read, also where a page of the others was
written; 2 on a wrong command line"""


def build_parser() -> Parser:
    parser = new_parser("elf-view", DESCRIPTION, EPILOG)
    parser.add_argument("folder", metavar="FOLDER", help="folder of images, or of results of elf-detect")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("view.html"), metavar="FILE",
        help="the page, whose folder is made; default: view.html. Only a page of elf-view is overwritten",
    )  # fmt: skip
    parser.add_argument("-r", "--recursive", action="store_true", help="take the images in subfolders too")
    parser.add_argument("--open", action="store_true", help="open the page in the browser")
    options.add_quiet(parser)
    options.add_mask(parser)
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
    if not args.quiet:
        say(f"{folder}: {len(paths)} {'results of elf-detect' if are_results else 'images'}")
    images = _Images(elf, paths, are_results, args, progress)
    try:
        write_page(args.output, f"ELF keypoints: {folder.resolve().name}", images)
    finally:
        progress.close()
    progress.close(images.summary())
    if args.open and not webbrowser.open(args.output.resolve().as_uri()):
        raise ElfError(f"{args.output} is written, and no browser could be started to show it")
    return command.FAILED if images.failed else 0


def _inputs(folder: Path, args: argparse.Namespace) -> tuple[list[Path], bool]:
    """The images of the folder, or, where it has none, the results in and below it; and whether they are results."""
    results = Listing() if images_in(folder, args.recursive).files else files_in(folder, True, (".npz",))
    if not results.files:
        try:
            return list(image_files([str(folder)], args.recursive)), False
        except UsageError as error:
            raise UsageError(f"{error}, and no results of elf-detect (.npz)") from error
    if args.mask is not None:
        raise UsageError(f"{folder} has results, which are shown as they were made: leave out --mask")
    given = sorted(name for name, value in options.settings(args).items() if value is not None)
    if given:
        raise UsageError(
            f"{folder} has results, whose settings are those that they were made with: leave out {given[0]}"
        )
    return sorted([*results.files, *results.shut]), True


def _check_output(output: Path, paths: Sequence[Path]) -> None:
    """Refuse to write what is no page, or over what is none."""
    if output.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"-o {output}: the page is an .html file")
    check_outputs({"-o": [output]}, {"an input": list(paths)}, made=output.parent)
    if output.exists() and not is_page(output):
        raise UsageError(f"-o {output}: this file is no page of elf-view; give another name")


class _Images:
    """The images of the page, one after the other, so that one of them is in memory at a time."""

    def __init__(
        self, elf: ElfRuntime, paths: Sequence[Path], are_results: bool, args: argparse.Namespace, progress: Progress
    ) -> None:
        self._elf, self._paths, self._are_results, self._args = elf, paths, are_results, args
        self._progress, self._mask = progress, options.read_mask(args)
        self.failed: list[str] = []

    def __iter__(self) -> Iterator[Shown]:
        """Those that can be had; what is wrong with another is said.

        Raises
        ------
        SettingError
            On settings that no image can have.
        ElfError
            At the end, if there was none.
        """
        for path in self._paths:
            name = str(path.relative_to(self._args.folder))
            try:
                image = self._shown(path, name)
            except (ElfError, OSError) as error:
                if isinstance(error, SettingError) and not self._are_results:  # the same for all
                    raise
                self.failed.append(command.text_of(error))
                self._progress.failed(self.failed[-1])
                self._progress.advance()
                continue
            self._progress.done(printable(f"{name}: {image.note}" if image.note else name))
            yield image
        if len(self.failed) == len(self._paths):
            raise ElfError(f"{self._args.folder}: none of its files can be shown, so no page is written")

    def _shown(self, path: Path, name: str) -> Shown:
        if self._are_results:
            return of_result(self._elf, path, name.removesuffix(".npz"))
        params = options.params(self._elf, self._args)
        pixels = options.read_image(path, self._args)
        with image_errors(path):
            return detected(self._elf, name, pixels, params, self._args.descriptor, self._mask)

    def summary(self) -> str:
        """The last line, and the failures once more."""
        count, megabytes = len(self._paths) - len(self.failed), self._args.output.stat().st_size / 1e6
        text = f"{count} images -> {self._args.output}, {megabytes:.1f} MB"
        if self.failed and not self._args.quiet:
            text += f", {len(self.failed)} failed:"
        return "\n".join([text, *(f"  {error}" for error in self.failed)])


if __name__ == "__main__":
    sys.exit(main())
