"""Where what takes the place of one node goes."""

from __future__ import annotations

import onnx

from elf_export.dialect.emitter import Emitter
from elf_export.graph.graph import Graph


class Site(Emitter):
    """The place of a node of the adjoint; names begin as the node's does.

    Attributes
    ----------
    like : str
        A forward value of the shape and the type of the node's result.
    """

    def __init__(self, graph: Graph, node: onnx.NodeProto, like: str | None = None) -> None:
        super().__init__(graph, node, node.name.rpartition("/")[0] or node.name)
        self.like = node.input[-1] if like is None else like

    @property
    def channels(self) -> int | None:
        """C of `like`, (N, C, H, W); None if it has another rank, or C is not known."""
        return channels_of(self.graph, self.like)

    @property
    def known_channels(self) -> int:
        """C of `like`, which must be known."""
        channels = self.channels
        assert channels is not None, f"unknown channels of {self.like!r}"
        return channels


def channels_of(graph: Graph, value: str) -> int | None:
    shape = graph.shape(value) or []
    return shape[1] if len(shape) == 4 and isinstance(shape[1], int) else None
