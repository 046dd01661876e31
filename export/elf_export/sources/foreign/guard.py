"""Whatever goes wrong with a user's model is an ExportError of one line."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import onnx

from elf_export.errors import ExportError
from elf_runtime.errors import ElfError, first_line, printable


@contextmanager
def only_export_errors(file: str | os.PathLike[str]) -> Iterator[None]:
    """Raise what onnx, protobuf, onnxruntime or Python's own types raise inside as an ExportError about `file`.

    What can be foreseen is refused where it is read, with better words.  A closed standard output is no fault of the
    model's and passes.
    """
    name = shown_path(file)
    try:
        yield
    except (ExportError, BrokenPipeError):
        raise
    except ElfError as error:
        raise ExportError(f"{name}: {first_line(error)}") from error
    except MemoryError as error:
        raise ExportError(f"{name}: there is not enough memory for this model") from error
    except onnx.shape_inference.InferenceError as error:
        raise ExportError(f"{name}: its types or sizes are at odds: {first_line(error)}") from error
    except RecursionError as error:
        raise ExportError(f"{name}: its graphs are nested too deeply") from error
    except Exception as error:  # onnxruntime's own exceptions share no base of theirs
        raise ExportError(
            f"{name}: can't be handled ({type(error).__name__}: {first_line(error)}).  If onnx.checker.check_model "
            "accepts it, please report it, with the model"
        ) from error


def shown_path(file: str | os.PathLike[str]) -> str:
    """A path for a message, on one line whatever its name holds."""
    return printable(os.fsdecode(file))
