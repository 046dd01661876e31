"""The last of our operations written out: masks, a step in the form that is fast in the target's numbers."""

from __future__ import annotations

from collections.abc import Callable

from elf_export.dialect import OWN, is_own
from elf_export.graph.graph import Graph

from . import depthwise, plain
from .site import Site
from .walk import take_place


def by_slope(site: Site, v: str) -> str:
    """HardSigmoid(1e30 v - 1), in an eighth of Sign's time: exactly 1 from v = 2e-30 on, and 0 up to 1e-30.

    The 1 is there because OpenVINO takes an offset of 0 for an absent one, whose default is 0.5.
    """
    return site.op("HardSigmoid", v, role="step", alpha=1e30, beta=-1.0)


def by_sign(site: Site, v: str) -> str:
    """max(sign v, 0), whatever the precision: float16 has no slope of 1e30."""
    return site.op("Relu", site.op("Sign", v, role="sign"), role="step")


STEPS: dict[str, Callable[[Site, str], str]] = {"fast": by_slope, "int8": by_slope, "plain": by_sign, "fp16": by_sign}


def write_steps(graph: Graph, target: str = "fast") -> Graph:
    """Step, Complement and Between in standard operations.

    requires : no other operation of `dialect`; shapes, for the number of channels.
    call : on a finished graph, or where it is to be run.
    ensures : the same values under the same names; a graph of the standard operations alone.
    """
    for op in ("Between", "Complement", "Step"):  # the first makes the last
        for node in [node for node in graph.nodes if is_own(node, op)]:
            site = Site(graph, node)
            channels = site.channels if op == "Complement" else None
            with graph.replace_node(node):
                if op == "Between":
                    made = plain.between(site)
                elif op == "Step":
                    made = STEPS[target](site, node.input[0])
                elif channels is not None:
                    made = depthwise.convolve(site, site.like, [[-1]], [1, 1], "complement", bias=1.0)
                else:
                    made = site.op("Sub", site.const(1, "one", like=site.like), site.like, role="complement")
                take_place(graph, made, node)
    imports = graph.model.opset_import
    for at in reversed(range(len(imports))):
        if imports[at].domain == OWN:
            del imports[at]
    return graph
