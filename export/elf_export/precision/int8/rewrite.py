"""A float graph to one in 8-bit integers, as QuantizeLinear and DequantizeLinear pairs around its nodes.

Where a value is rounded as it is made, ALL its readers get the rounded one: the two sides of every comparison (a
max-pool's winner, a ReLU's sign) are the same numbers, and the graph differentiates the rounded network.  A value that
comes from floats is rounded for convolutions alone, for the same reason.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
import onnx

from elf_export.graph.graph import GraphView, attributes

from .candidates import CLAMPING, COMBINING, MOVING, is_convolution, makes_step, only_reader
from .convolve import BREADTH, convolve, magnitude_of_two, two_steps_of
from .masks import mask
from .quantizer import Quantizer
from .scheme import Scheme, reaching


def rewrite(
    source: GraphView, schemes: Mapping[str, Scheme], left: Collection[str] = ()
) -> tuple[onnx.ModelProto, dict[str, str]]:
    """A new model that has the convolutions of `source`, and what lies between them, in 8-bit integers.

    Parameters
    ----------
    source : GraphView
        In float32, opset 13 or later.
    schemes : mapping
        How to round the values of `candidates(source)`.
    left : collection of str
        Results of convolutions that stay in floats.

    Returns
    -------
    model : onnx.ModelProto
    origins : dict
        Result of each 8-bit convolution -> that of the node which it takes the place of.
    """
    quantizer = Quantizer(source, schemes, left)
    for node, own in zip(source.nodes, list(quantizer.graph.nodes), strict=True):
        with quantizer.graph.replace_node(own):
            _visit(quantizer, node)
    del quantizer.graph.model.graph.value_info[:]
    quantizer.graph.prune()
    return quantizer.graph.model, quantizer.origins


def _visit(quantizer: Quantizer, node: onnx.NodeProto) -> None:
    if is_convolution(quantizer.source, node):
        if not makes_step(quantizer.readers, node):
            _convolution(quantizer, node)
    elif not (mask(quantizer, node) or (node.op_type in MOVING and _moved(quantizer, node))):
        quantizer.keep(node)
        _round_result(quantizer, node)


def _is_fed_integers(quantizer: Quantizer, node: onnx.NodeProto) -> bool:
    """Whether the convolution's input is in integers, or has been put into such for its sake."""
    x = node.input[0]
    if node.output[0] in quantizer.left:
        return False
    dear = attributes(node).get("group", 1) == 1
    if x not in quantizer.rounding and x in quantizer.schemes and dear:
        # Others may compare it with what is not rounded, such as a max-pool's inputs with its result.
        quantizer.round(x, quantizer.schemes[x])
        quantizer.inside.add(x)
    return x in quantizer.rounding


def _convolution(quantizer: Quantizer, node: onnx.NodeProto) -> None:
    x, y = node.input[0], node.output[0]
    if not _is_fed_integers(quantizer, node):
        quantizer.keep(node)
        return
    kernel = quantizer.source.constant(node.input[1])
    assert kernel is not None, "checked by is_convolution"
    bias = quantizer.source.constant(node.input[2]) if len(node.input) > 2 and node.input[2] else None
    after = only_reader(quantizer.readers, y)
    simple = bias is None and attributes(node).get("group", 1) == 1
    if after is not None and after.op_type == "Abs" and simple and y in quantizer.schemes:
        both = quantizer.graph.unique(f"{y}/both")
        convolve(quantizer, node, x, two_steps_of(kernel, BREADTH), None, both)
        quantizer.origins[both] = y
        quantizer.round(both, quantizer.schemes[y])
        magnitude_of_two(quantizer, y, both, len(kernel))
        return
    convolve(quantizer, node, x, kernel, bias, y)
    quantizer.origins[y] = y
    quantizer.convolved.add(y)
    if y in quantizer.schemes and not (after is not None and after.op_type in CLAMPING):
        quantizer.round(y, quantizer.schemes[y])


def _moved(quantizer: Quantizer, node: onnx.NodeProto) -> bool:
    """Move integers where the values are moved; False where they have none, or not one scheme."""
    data = list(node.input) if node.op_type == "Concat" else [node.input[0]]
    if not all(map(quantizer.is_rounded, data)):
        return False
    if len({quantizer.rounding[name] for name in data}) > 1 or len(node.output) > 1:
        return False
    scheme, result = quantizer.rounding[data[0]], node.output[0]
    inputs = [quantizer.integers.get(name, name) for name in node.input]
    if node.op_type == "Pad":
        fill = quantizer.source.constant(inputs[2]) if len(inputs) > 2 and inputs[2] else np.zeros(())
        if fill is None or np.any(fill):
            return False
        inputs[2:3] = [quantizer.graph.const(np.uint8(scheme.zero), f"{result}/fill")]
    q = quantizer.graph.op(node.op_type, *inputs, name=f"{result}/q", **attributes(node))
    quantizer.dequantize(result, q, scheme)
    if result in quantizer.outputs:
        quantizer.graph.op("Identity", quantizer.twins[result], name=f"{result}/out", outputs=[result])
    if data[0] in quantizer.masks:
        quantizer.masks.add(result)
    return True


def _round_result(quantizer: Quantizer, node: onnx.NodeProto) -> None:
    """Round what a node other than a convolution gives, where its inputs are rounded."""
    result = node.output[0]
    data = [name for name in node.input if name and not quantizer.source.is_constant(name)]
    known = [quantizer.rounding[name] for name in data if quantizer.is_rounded(name)]
    if node.op_type in CLAMPING:
        if result in quantizer.schemes and (known or node.input[0] in quantizer.convolved):
            quantizer.round(result, _up_to_bound(quantizer, node, quantizer.schemes[result]))
    elif not known or len(known) < len(data):
        return
    elif node.op_type == "Mul" and len(data) == 2 and quantizer.masks.intersection(data):
        if quantizer.masks.issuperset(data):
            quantizer.round_mask(result)
        else:
            quantizer.round(result, quantizer.shared.get(result, known[data[0] in quantizer.masks]))
    elif node.op_type in COMBINING and result in quantizer.schemes:
        quantizer.round(result, quantizer.schemes[result])


def _up_to_bound(quantizer: Quantizer, node: onnx.NodeProto, scheme: Scheme) -> Scheme:
    """The scheme whose highest level is a Clip's upper bound, to the last bit: no gradient passes there."""
    bound = quantizer.source.constant(node.input[2]) if len(node.input) > 2 and node.input[2] else None
    if bound is None or scheme.zero or not 0.0 < float(bound) < np.inf:
        return scheme
    return reaching(float(bound))
