"""The operations of `dialect` in standard ONNX ones, in the form that is fast where the graph will run.

`walk` goes through the graph, with the forms of `plain`, which uses nothing clever.  Every other target is a file:
`blocked` is for float CPUs, `channels_last` for 8-bit ones, `common` what the two have in common; `phases`, `pools`,
`interleave`, `depthwise` and `scatter` are their means.  `steps` writes out what is left, the masks.  May import
`dialect` and `graph`; nothing here knows how an operation of the network is differentiated.
"""

from __future__ import annotations

from collections.abc import Collection

from elf_export.graph.graph import Graph

from .blocked import Blocked
from .channels_last import ChannelsLast
from .steps import write_steps
from .walk import Lowering

__all__ = ["TARGETS", "lower", "write_steps"]

TARGETS: dict[str, type[Lowering]] = {"fast": Blocked, "int8": ChannelsLast, "plain": Lowering}


def lower(graph: Graph, target: str = "fast", keep: Collection[str] = ()) -> Graph:
    """Put a target's form in the place of every operation of `dialect` but the masks, which `write_steps` writes.

    Parameters
    ----------
    graph : Graph
        Edited.
    target : str
        A key of `TARGETS`.
    keep : names
        Values beside the graph's outputs that are asked for.
    """
    return TARGETS[target](graph, keep).run()
