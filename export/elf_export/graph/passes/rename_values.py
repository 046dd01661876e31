"""Give values of a model other names."""

from __future__ import annotations

from collections.abc import Mapping

from elf_export.graph.graph import Graph


def rename_values(graph: Graph, names: Mapping[str, str]) -> Graph:
    """Call each value of `names`, old name -> new name, by its new one.

    requires : new names that nothing has yet (`Graph.unique` gives such).
    call : before names are compared with those of an export's own inputs and outputs.
    ensures : the same graph otherwise.  Bodies of control-flow nodes read outer values by name: there too.
    """
    graph.rename(names)
    return graph
