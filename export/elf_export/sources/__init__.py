"""Where a network comes from: a name and trained weights (`networks`, `weights`), or anybody's ONNX file (`foreign`).

Both give a `Source`.  May import `checks`, whose oracles a source brings, `saliency`, `graph` and what lies below.
"""

from __future__ import annotations

from collections.abc import Callable

from elf_export.request import Request

from .foreign.detector import foreign_detector
from .named import describer, named_detector
from .source import Source, Sources
from .variants import varied

__all__ = ["Source", "Sources", "open_sources"]


def open_sources(request: Request, log: Callable[[str], None]) -> Sources:
    """The network that detects, and the others that describe.

    Raises
    ------
    ExportError
        If one of them can't be had.
    """
    detector = (foreign_detector if request.net is None else named_detector)(request, log)
    others: dict[str, list[str]] = {}
    for label in detector.request.desc or ():
        if label not in detector.descriptors:
            network, _, layer = label.rpartition(":")
            others.setdefault(network, []).append(layer)
    return varied(Sources(detector, tuple(describer(name, layers, detector, log) for name, layers in others.items())))
