"""Which input is the image, and where its channels are: NCHW or NHWC."""

from __future__ import annotations

from collections.abc import Sequence

from elf_export.errors import LayerError

from .graph import Dim, GraphView

COLOR_CHANNELS = (1, 3)


def only_image_input(graph: GraphView) -> str:
    """The graph's one 4-dimensional input.

    Raises
    ------
    LayerError
        If there is none, or several.
    """
    found = [name for name in graph.inputs if graph.rank(name) == 4 and not graph.is_constant(name)]
    if len(found) != 1:
        raise LayerError(f"which input is the image? The model takes {graph.inputs}; name it")
    return found[0]


def image_layout(graph: GraphView, name: str) -> str:
    """ "NCHW" or "NHWC" of an input of rank 4, told as `find_image_input` does."""
    return layout_of(graph, name, graph.shape(name) or [None] * 4)[0]


def layout_of(graph: GraphView, name: str, shape: Sequence[Dim]) -> tuple[str, int]:
    """Layout and channels of an input of rank 4: by its sizes, else by the first Conv's kernel."""
    first, last = static_size(shape[1]), static_size(shape[3])
    like_channels = [c in COLOR_CHANNELS for c in (first, last)]
    if like_channels == [True, False]:
        return "NCHW", first or 0
    if like_channels == [False, True]:
        return "NHWC", last or 0
    if first is not None and last is not None and not any(like_channels):
        return "NCHW", 0
    return _layout_by_use(graph, name)


def _layout_by_use(graph: GraphView, name: str) -> tuple[str, int]:
    """Follow the input to its first Conv: what it goes through tells where the channels are."""
    readers = graph.consumers()
    perm = [0, 1, 2, 3]
    while True:
        nodes = readers.get(name, [])
        if not nodes:
            return "NCHW", 0
        node = nodes[0]
        if node.op_type == "Conv" and node.input[0] == name:
            kernel = graph.shape(node.input[1]) or []
            group = next((a.i for a in node.attribute if a.name == "group"), 1)
            channels = (static_size(kernel[1]) or 0) * group if len(kernel) > 1 else 0
            return ("NCHW" if perm == [0, 1, 2, 3] else "NHWC"), channels
        if node.op_type == "Transpose":
            step = next((list(a.ints) for a in node.attribute if a.name == "perm"), [3, 2, 1, 0])
            perm = [perm[i] for i in step]
        name = node.output[0]


def static_size(dim: Dim) -> int | None:
    """A stated size; Paddle writes -1 for a free one."""
    return dim if isinstance(dim, int) and dim > 0 else None
