"""The networks that `elf-export --net` knows.

Each is a file of its name that ends in a ``NETWORK``; nothing else lists it.  `parts` has what they are made of.  May
import `weights` (where the tensors come from), the preprocessing and errors.
"""

from __future__ import annotations

import importlib
import pkgutil

from elf_export.errors import ExportError
from elf_runtime.errors import suggestion

from .parts.network import Network

__all__ = ["Network", "get_network", "network_names"]


def network_names() -> list[str]:
    """By the names of the files, so that none is imported, nor PyTorch with it; the paper's main one comes first."""
    names = (module.name for module in pkgutil.iter_modules(__path__) if not module.ispkg)
    return sorted(names, key=lambda name: (name != "vgg", name))


def get_network(name: str) -> Network:
    """The network called `name`.

    Raises
    ------
    ExportError
        If there is none, or PyTorch, which named networks are built with, is not installed.
    """
    if name not in network_names():
        raise ExportError(
            f"unknown network {name!r}; known are {', '.join(network_names())}{suggestion(name, network_names())}"
        )
    try:
        network = importlib.import_module(f".{name}", __name__).NETWORK
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise ExportError(
            f"--net {name} is built with PyTorch: pip install torch (the CPU build is enough), then pip install "
            '".[export]"'
        ) from error
    assert isinstance(network, Network)
    return network
