"""COLMAP's incremental mapper, from a database to models on disk."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from elf_runtime.errors import ElfError, first_line

from .library import SEED, quiet
from .model import Model, model_of


def map_database(
    database: str | os.PathLike[str],
    images: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    refine: bool = True,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> list[Model]:
    """Place the images of a database, triangulate points, and write what comes of it.

    Parameters
    ----------
    database : path
        As `write_database` writes it.
    images : path
        Folder of the images, which the points get their colours from.
    output : path
        An existing folder.  It gets a folder ``0`` with the model that has most images, in COLMAP's binary files, and
        ``1`` and so on with others, where parts of the scene do not hang together.
    refine : bool
        Whether focal lengths and distortions are estimated too, or stay as they are.  Principal points stay.
    threads : int, optional
        By default all cores.
    progress : function, optional
        Called with the number of images that are placed, each time that one is.

    Returns
    -------
    list of Model
        The largest first; at least one.

    Raises
    ------
    ElfError
        If pycolmap is not there, or no two images could be placed.
    """
    with quiet() as colmap, tempfile.TemporaryDirectory(dir=output) as part:
        placed, options = _Counter(progress), _options(colmap, refine, threads)
        found: dict[int, Any] = {}
        # COLMAP leaves out points that two images alone show.  Where these are all there are, it is asked to take them.
        for options.triangulation.ignore_two_view_tracks in (True, False):
            try:
                found = found or colmap.incremental_mapping(
                    os.fspath(database), os.fspath(images), part, options,
                    initial_image_pair_callback=placed.begin, next_image_callback=placed.next,
                )  # fmt: skip
            except (RuntimeError, ValueError) as error:
                raise ElfError(f"COLMAP's mapper failed: {first_line(error)}") from error
        models = sorted(found.values(), key=lambda model: -model.num_reg_images())
        if not models:
            raise ElfError(
                "no two images could be placed: they share too few matches, or were taken from one place; more overlap "
                "or more keypoints help, and a calibration"
            )
        for number, model in enumerate(models):
            folder = Path(output, str(number))
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            model.write_binary(os.fspath(folder))
        return [model_of(model) for model in models]


def _options(colmap: Any, refine: bool, threads: int | None) -> Any:
    options = colmap.IncrementalPipelineOptions()
    options.ba_refine_focal_length = options.ba_refine_extra_params = refine
    options.mapper.abs_pose_refine_focal_length = options.mapper.abs_pose_refine_extra_params = refine
    options.num_threads = options.mapper.num_threads = -1 if threads is None else threads
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = SEED
    return options


class _Counter:
    """How many images the mapper has placed: a pair, then one by one; another model begins with a pair again."""

    def __init__(self, progress: Callable[[int], None] | None) -> None:
        self._count, self._progress = 0, progress

    def begin(self) -> None:
        self._say(2)

    def next(self) -> None:
        self._say(self._count + 1)

    def _say(self, count: int) -> None:
        self._count = count
        if self._progress:
            self._progress(count)
