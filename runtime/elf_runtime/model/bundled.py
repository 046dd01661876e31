"""The models that come with the package, whether Python imports it from a folder, an archive or a frozen program."""

from __future__ import annotations

import atexit
import os
import pkgutil
import shutil
import tempfile
from importlib import resources
from pathlib import Path

from elf_runtime.errors import ModelError

PACKAGE = "elf_runtime"
BUNDLED = {"fp32": "elf-vgg.onnx", "int8": "elf-vgg-int8.onnx"}
_paths: dict[str, Path] = {}


def read_bundled(precision: str = "fp32") -> tuple[bytes, str]:
    """The bytes of the model that comes with the package, and its name for messages.

    Raises
    ------
    ModelError
        If it is not where the package is: a program was frozen or packed without it, or the wheel is a lean one.
    """
    name = BUNDLED[precision]
    try:
        resource = resources.files(PACKAGE) / "models" / name
        return resource.read_bytes(), str(resource)
    except Exception:  # importers of frozen programs lack one or the other part of importlib's interface
        try:
            data = pkgutil.get_data(PACKAGE, f"models/{name}")
        except OSError:
            data = None
    if data is None:
        lean = "The lean wheel has the one in int8 alone. " if precision == "fp32" else ""
        raise ModelError(
            f"the bundled model {name} is missing where elf_runtime is imported from. {lean}If this program was frozen "
            "or packed, put the package's data files into it (PyInstaller: --collect-data elf_runtime), or give "
            "ElfRuntime a model file"
        )
    return data, f"<elf_runtime>/models/{name}"


def bundled_model(precision: str = "fp32") -> Path:
    """Path of the model that comes with the package, in "fp32" or "int8": the same network, layers and settings.

    Where the package is not a folder of files, it is that of a temporary copy, which is removed when the process ends.

    Raises
    ------
    ModelError
        As `read_bundled`.
    """
    name = BUNDLED[precision]
    if name not in _paths or not _paths[name].is_file():
        data, where = read_bundled(precision)
        _paths[name] = Path(where)
        if not _paths[name].is_file():
            folder = Path(tempfile.mkdtemp(prefix="elf-onnx-"))
            atexit.register(_remove, folder, os.getpid())
            (folder / name).write_bytes(data)
            _paths[name] = folder / name
    return _paths[name]


def _remove(folder: Path, owner: int) -> None:
    if os.getpid() == owner:  # and not a child that inherited the copy
        shutil.rmtree(folder, ignore_errors=True)
