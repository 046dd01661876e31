"""ONNX Runtime's own file format (.ort): FlatBuffers in place of protobuf, read faster and by reduced builds too.

https://onnxruntime.ai/docs/performance/model-optimizations/ort-format-models.html
"""

from __future__ import annotations

import os
from pathlib import Path

import onnxruntime as ort

from elf_runtime.contract import ModelContract
from elf_runtime.errors import ModelError, first_line
from elf_runtime.files.write import write_atomically

from .forking import opened
from .onnx_file import read_onnx

_MARK = slice(4, 8)  # where a file of FlatBuffers has its four letters


def is_ort_format(source: str | os.PathLike[str] | bytes) -> bool:
    """Whether the file, or its bytes, is in ORT format; False for a file that can't be read."""
    if isinstance(source, bytes):
        return source[_MARK] == b"ORTM"
    try:
        with Path(source).open("rb") as file:
            return file.read(8)[_MARK] == b"ORTM"
    except (OSError, TypeError):  # whoever opens the model says what is wrong with it
        return False


def to_ort(model: str | os.PathLike[str], output: str | os.PathLike[str], this_machine: bool = False) -> Path:
    """Write an ELF model in ORT format; metadata and free image sizes stay.

    Parameters
    ----------
    model : path
        The .onnx file.
    output : path
        Ends in ``.ort``.
    this_machine : bool
        Keep the layout that suits this processor's vectors too: the file then runs as fast as the .onnx file, on
        processors with the same vector width only.  False writes a file that runs everywhere; on x86 it takes about
        1.7 times as long.

    Returns
    -------
    Path
        `output`.  Where writing fails, what was there before stays.

    Raises
    ------
    ModelError
        If `model` is no ELF model or can't be loaded, or `output` can't be written or has another ending.
    """
    source, target = Path(model), Path(output)
    if target.suffix != ".ort":
        raise ModelError(f"{target}: a file in ORT format ends in .ort; onnxruntime goes by it")
    if is_ort_format(source):
        raise ModelError(f"{source}: is in ORT format already")
    ModelContract.from_metadata(read_onnx(source).metadata, str(source))
    level = ort.GraphOptimizationLevel
    options = ort.SessionOptions()
    options.log_severity_level = 3  # it warns that the file is for this machine
    options.graph_optimization_level = level.ORT_ENABLE_ALL if this_machine else level.ORT_ENABLE_EXTENDED
    options.add_session_config_entry("session.save_model_format", "ORT")

    def write(temporary: Path) -> None:
        options.optimized_model_filepath = str(temporary)
        opened(lambda: ort.InferenceSession(str(source), options, providers=["CPUExecutionProvider"]))

    try:
        write_atomically(target, write)
    except Exception as error:  # onnxruntime's own exceptions share no base of theirs
        reason = first_line(error)
        raise ModelError(f"{target}: can't write {source} in ORT format: {reason}") from error
    return target
