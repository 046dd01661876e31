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

from .candidates import CLAMPING, COMBINING, MOVING, is_convolution, is_spreading, makes_step, only_reader
from .convolve import BREADTH, convolve, magnitude_of_two, two_steps_of
from .integers import Rewriting
from .masks import complement, mask
from .scheme import Scheme, reaching
from .spread import spread


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
    state = Rewriting(source, schemes, left)
    for node, own in zip(source.nodes, list(state.graph.nodes), strict=True):
        with state.graph.replace_node(own):
            _visit(state, node)
    del state.graph.model.graph.value_info[:]
    state.graph.prune()
    return state.graph.model, state.origins


def _visit(state: Rewriting, node: onnx.NodeProto) -> None:
    if is_convolution(state.source, node):
        if not (makes_step(state.readers, node) or complement(state, node)):
            _convolution(state, node)
    elif is_spreading(state.source, state.readers, node):
        if node.output[0] in state.schemes and _is_fed_integers(state, node):
            spread(state, node)
        else:
            state.keep(node)
    elif not (mask(state, node) or (node.op_type in MOVING and _moved(state, node))):
        state.keep(node)
        _round_result(state, node)


def _is_fed_integers(state: Rewriting, node: onnx.NodeProto) -> bool:
    """Whether the convolution's input is in integers, or has been put into such for its sake."""
    x = node.input[0]
    if node.output[0] in state.left:
        return False
    dear = attributes(node).get("group", 1) == 1 or node.op_type == "ConvTranspose"
    if x not in state.rounding and x in state.schemes and dear:
        # Others may compare it with what is not rounded, such as a max-pool's inputs with its result.
        state.round(x, state.schemes[x])
        state.inside.add(x)
    return x in state.rounding


def _convolution(state: Rewriting, node: onnx.NodeProto) -> None:
    x, y = node.input[0], node.output[0]
    if not _is_fed_integers(state, node):
        state.keep(node)
        return
    kernel = state.source.constant(node.input[1])
    assert kernel is not None, "is_convolution has seen to that"
    bias = state.source.constant(node.input[2]) if len(node.input) > 2 and node.input[2] else None
    after = only_reader(state.readers, y)
    simple = bias is None and attributes(node).get("group", 1) == 1
    if after is not None and after.op_type == "Abs" and simple and y in state.schemes:
        both = state.graph.unique(f"{y}/both")
        convolve(state, node, x, two_steps_of(kernel, BREADTH), None, both)
        state.origins[both] = y
        state.round(both, state.schemes[y])
        magnitude_of_two(state, y, both, len(kernel))
        return
    convolve(state, node, x, kernel, bias, y)
    state.origins[y] = y
    state.convolved.add(y)
    if y in state.schemes and not (after is not None and after.op_type in CLAMPING):
        state.round(y, state.schemes[y])


def _moved(state: Rewriting, node: onnx.NodeProto) -> bool:
    """Move integers where the values are moved; False where they have none, or not one scheme."""
    data = list(node.input) if node.op_type == "Concat" else [node.input[0]]
    if not all(map(state.is_rounded, data)):
        return False
    if len({state.rounding[name] for name in data}) > 1 or len(node.output) > 1:
        return False
    scheme, result = state.rounding[data[0]], node.output[0]
    inputs = [state.integers.get(name, name) for name in node.input]
    if node.op_type == "Pad":
        fill = state.source.constant(inputs[2]) if len(inputs) > 2 and inputs[2] else np.zeros(())
        if fill is None or np.any(fill):
            return False
        inputs[2:3] = [state.graph.const(np.uint8(scheme.zero), f"{result}/fill")]
    q = state.graph.op(node.op_type, *inputs, name=f"{result}/q", **attributes(node))
    state.dequantize(result, q, scheme)
    if result in state.outputs:
        state.graph.op("Identity", state.twins[result], name=f"{result}/out", outputs=[result])
    if data[0] in state.masks:
        state.masks.add(result)
    return True


def _round_result(state: Rewriting, node: onnx.NodeProto) -> None:
    """Round what a node other than a convolution gives, where its inputs are rounded."""
    result = node.output[0]
    data = [name for name in node.input if name and not state.source.is_constant(name)]
    known = [state.rounding[name] for name in data if state.is_rounded(name)]
    if node.op_type in CLAMPING:
        if result in state.schemes and (known or node.input[0] in state.convolved):
            state.round(result, _up_to_bound(state, node, state.schemes[result]))
    elif not known or len(known) < len(data):
        return
    elif node.op_type == "Mul" and len(data) == 2 and state.masks.intersection(data):
        if state.masks.issuperset(data):
            state.round_mask(result)
        else:
            state.round(result, state.shared.get(result, known[data[0] in state.masks]))
    elif node.op_type in COMBINING and result in state.schemes:
        state.round(result, state.schemes[result])


def _up_to_bound(state: Rewriting, node: onnx.NodeProto, scheme: Scheme) -> Scheme:
    """The scheme whose highest level is a Clip's upper bound, to the last bit: no gradient passes there."""
    bound = state.source.constant(node.input[2]) if len(node.input) > 2 and node.input[2] else None
    if bound is None or scheme.zero or not 0.0 < float(bound) < np.inf:
        return scheme
    return reaching(float(bound))
