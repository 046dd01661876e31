"""One walk through a graph, from its first node to its last, that puts standard operations in the place of ours."""

from __future__ import annotations

from collections.abc import Callable, Collection

import onnx
from onnx import helper

from elf_export.dialect import is_own
from elf_export.graph.graph import Graph

from . import interleave, plain
from .phases import Phases
from .site import Site

Made = str | Phases
Form = Callable[[Site], Made]


def take_place(graph: Graph, made: str, node: onnx.NodeProto) -> None:
    """Let the value `made`, just emitted, be the result of `node`, and its node be called as that was."""
    maker = graph.producers()[made]
    graph.rewire(maker, outputs=[node.output[0] if name == made else name for name in maker.output])
    graph.replace_uses(made, node.output[0])
    maker.name = node.name


class Lowering:
    """The plain forms; a target that has others overrides them.

    requires : nodes in the order in which they run.
    call : once, behind all that appends operations of `dialect`; `keep` are values that are asked for.
    ensures : the outputs and `keep` have the same values, in standard operations, Step and Complement, which `steps`
        takes out, and whatever of `dialect` the target leaves for a later pass of its own.
    """

    def __init__(self, graph: Graph, keep: Collection[str] = ()) -> None:
        self.graph = graph
        self.keep = {*keep, *graph.outputs}
        self.parts: dict[str, Phases] = {}  # values that are there in phases, and not whole
        self.interleaved: set[str] = set()  # values that were put together outside the blocked layout
        self.forms = {
            "MaxPoolGrad": self.max_pool_grad, "WindowSum": self.window_sum, "ConvGrad": self.conv_grad,
            "Between": self.between,
        }  # fmt: skip

    def run(self) -> Graph:
        for node in list(self.graph.nodes):
            form = self.forms.get(node.op_type) if is_own(node) else None
            if form is not None:
                self._replace(node, form)
            elif not self.passes(node):
                with self.graph.insert_before(node):
                    for name in node.input:
                        self.whole(name)
        for name in self.keep:
            self.whole(name)
        for node in [node for node in self.graph.nodes if is_own(node) and not self._is_read(node.output[0])]:
            self.graph.remove(node)
        return self.graph

    def _replace(self, node: onnx.NodeProto, form: Form) -> None:
        output = node.output[0]
        with self.graph.replace_node(node):
            made = form(Site(self.graph, node))
            if isinstance(made, Phases):
                self.parts[output] = made
            elif made != output:
                take_place(self.graph, made, node)

    def _is_read(self, name: str) -> bool:
        return name in self.keep or name in self.graph.consumers()

    def whole(self, name: str) -> str:
        """The value `name`, which is put together first if it is there in phases."""
        part = self.parts.pop(name, None)
        if part is not None:
            place = helper.make_node("Identity", [part.like], [name], name)
            interleave.whole(Site(self.graph, place), part, name)
            if not part.joined:
                self.interleaved.add(name)
        return name

    # -- the forms of a target -----------------------------------------------------------------------------------

    def max_pool_grad(self, site: Site) -> Made:
        self.whole(site.node.input[0])
        return plain.max_pool_grad(site)

    def window_sum(self, site: Site) -> Made:
        self.whole(site.node.input[0])
        return plain.window_sum(site)

    def conv_grad(self, site: Site) -> Made:
        self.whole(site.node.input[0])
        return plain.conv_grad(site)

    def between(self, site: Site) -> Made:
        return plain.between(site)

    def passes(self, _node: onnx.NodeProto) -> bool:
        """Do what a node that is none of ours does on phases; False where it takes its inputs whole."""
        return False
