"""pycolmap, which only this room needs: imported when it is used, and kept from writing to the terminal."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from elf_runtime.errors import ElfError, first_line

_OLDEST = 4  # major version
SEED = 0  # of all random samples: the same input gives the same result, on one thread


def pycolmap() -> Any:
    """The module.

    Raises
    ------
    ElfError
        If it is not installed, can't be loaded, or is older than what is used of it.
    """
    try:
        with _signals_kept():
            module = import_module("pycolmap")
    except Exception as error:  # a library that does not fit raises what it likes
        missing = isinstance(error, ModuleNotFoundError) and error.name == "pycolmap"
        why = "is not installed" if missing else f"can't be loaded ({first_line(error)})"
        raise ElfError(f'reconstruction needs pycolmap, which {why}: pip install "elf-onnx[sfm]"') from error
    if int(module.__version__.partition(".")[0]) < _OLDEST:
        raise ElfError(
            f"reconstruction needs pycolmap {_OLDEST}.0 or later, and this is {module.__version__}: "
            'pip install --upgrade "elf-onnx[sfm]"'
        )
    return module


@contextmanager
def _signals_kept() -> Iterator[None]:
    """Keep what SIGTERM does: pycolmap's logging would have it print a stack of C++ and end the process at once."""
    before = signal.getsignal(signal.SIGTERM)
    yield
    if before is not None and threading.current_thread() is threading.main_thread():  # only there can it be set
        signal.signal(signal.SIGTERM, before)


@contextmanager
def quiet() -> Iterator[Any]:
    """pycolmap with nothing logged, for its errors are raised; what it was set to comes back."""
    module = pycolmap()
    before = module.logging.minloglevel
    module.logging.minloglevel = int(module.logging.FATAL)
    try:
        yield module
    finally:
        module.logging.minloglevel = before
