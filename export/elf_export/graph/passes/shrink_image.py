"""The network sees its image at another size."""

from __future__ import annotations

from elf_export.graph.graph import Graph


def shrink_image(graph: Graph, image: str, layout: str, ratio: float) -> Graph:
    """The nodes that read `image` read it resized to `ratio` of its height and width.

    With k the whole part of 1 / ratio, the image is averaged over k x k pixels, and what is left of the ratio, 1/2 to
    1, is interpolated linearly; so is an enlargement.  Pixel i of the result is centred at (i + 1/2) / ratio - 1/2.

    requires : opset 11; `layout` is "NCHW" or "NHWC".
    call : on a forward graph, before preprocessing is put in front.
    ensures : the result has floor(floor(H / k) * ratio * k) rows, as many columns by W; the image is read here only.
    """
    first = next(node for node in graph.nodes if image in node.input)
    factor = max(1, int(1.0 / ratio + 1e-9))
    rest = ratio * factor
    readers = [node for node in graph.nodes if image in node.input]
    with graph.insert_before(first):
        value = image
        if layout != "NCHW":
            value = graph.op("Transpose", value, name="smaller/nchw", perm=[layout.index(axis) for axis in "NCHW"])
        if factor > 1:
            window = [factor, factor]
            value = graph.op("AveragePool", value, name="smaller/averaged", kernel_shape=window, strides=window)
        if abs(rest - 1.0) > 1e-9:
            scales = graph.const([1.0, 1.0, rest, rest], "smaller/scales", "float32")
            value = graph.op(
                "Resize", value, "", scales, name="smaller/resized", mode="linear",
                coordinate_transformation_mode="half_pixel",
            )  # fmt: skip
        if layout != "NCHW":
            value = graph.op("Transpose", value, name="smaller/back", perm=["NCHW".index(axis) for axis in layout])
    for node in readers:
        graph.rewire(node, inputs=[value if name == image else name for name in node.input])
    graph.retype(value)
    return graph
