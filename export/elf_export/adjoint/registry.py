"""The rule table: which op is differentiated how."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import onnx

from elf_export.dialect.emitter import Emitter
from elf_export.graph.graph import Graph, GraphView, is_standard

ADJOINT = "adj/"  # what the names of its nodes begin with
MIN_OPSET = 11  # Slice, Pad, Clip and Resize take their bounds as inputs from here on

Gradients = Sequence[str | None]
"""One gradient per input of the node, None where it gets none; trailing Nones may be left out."""

Rule = Callable[..., Gradients]
"""rule(ctx, node, *grad_y); one `grad_y` per differentiated output, None if nobody used it."""

RuleT = TypeVar("RuleT", bound=Rule)
Supports = Callable[["Context"], str | None]


class NeedsOpset(str):
    """Why a node can't be differentiated, where a later opset would mend that."""

    def __new__(cls, reason: str, opset: int) -> NeedsOpset:
        self = super().__new__(cls, reason)
        self.opset = opset
        return self

    opset: int


@dataclass(frozen=True)
class Entry:
    """A row of the table; the fields are the arguments of `adjoint`."""

    rule: Rule
    since_opset: int = MIN_OPSET
    supports: Supports | None = None
    inputs: int | None = 1
    outputs: int | None = 1
    broadcasts: bool = False
    core_axes: int = 0
    through_integers: bool = False


_RULES: dict[str, Entry] = {}
_NO_GRADIENT: set[str] = set()


class Context(Emitter):
    """What a rule may ask of the forward graph, and where it emits its nodes.

    Emitted nodes are named ``adj/<forward node>/<role>``, so that a profile pairs forward and backward.
    Shapes and dtypes are known of forward values only, not of what a rule has just emitted.
    """

    def __init__(self, graph: Graph, node: onnx.NodeProto, wanted: Sequence[bool] = ()) -> None:
        super().__init__(graph, node, f"{ADJOINT}{node.name or node.output[0]}")
        self.wanted = wanted  # which inputs need a gradient; a rule may skip the others


def adjoint(
    *ops: str,
    since_opset: int = MIN_OPSET,
    supports: Supports | None = None,
    inputs: int | None = 1,
    outputs: int | None = 1,
    broadcasts: bool = False,
    core_axes: int = 0,
    through_integers: bool = False,
) -> Callable[[RuleT], RuleT]:
    """Register a rule for `ops`.

    Parameters
    ----------
    since_opset : int
        First opset that the rule understands.
    supports : function, optional
        ``supports(ctx)`` returns why this node can't be differentiated, or None if it can.
    inputs, outputs : int, optional
        How many leading inputs the rule can differentiate, and of how many leading outputs it takes a
        gradient; None for all.  A node that needs more is reported, never silently cut short.
    broadcasts : bool
        The inputs are broadcast against one another; the engine sums their gradients back.
    core_axes : int
        Trailing axes that do not broadcast (2 for MatMul).
    through_integers : bool
        The gradient passes although an input or output holds integers (QuantizeLinear, DequantizeLinear).

    Raises
    ------
    ValueError
        If an op has a rule already.
    """

    def register(rule: RuleT) -> RuleT:
        for op in ops:
            _refuse_twice(op)
            _RULES[op] = Entry(rule, since_opset, supports, inputs, outputs, broadcasts, core_axes, through_integers)
        return rule

    return register


def no_gradient(*ops: str) -> None:
    """Register `ops` as constant almost everywhere, or not differentiable by nature (Shape, Floor ...)."""
    for op in ops:
        _refuse_twice(op)
        _NO_GRADIENT.add(op)


def _refuse_twice(op: str) -> None:
    if op in _RULES or op in _NO_GRADIENT:
        raise ValueError(f"op {op!r} is registered already")


def entry_for(node: onnx.NodeProto) -> Entry | None:
    """The table's row for a node, None without one."""
    return _RULES.get(node.op_type) if is_standard(node) else None


def has_no_gradient(node: onnx.NodeProto) -> bool:
    return is_standard(node) and node.op_type in _NO_GRADIENT


def is_straight_through(node: onnx.NodeProto) -> bool:
    """Whether a gradient passes through the node's integers."""
    entry = entry_for(node)
    return entry is not None and entry.through_integers


def is_floating(graph: GraphView, name: str) -> bool:
    """Whether a value holds real numbers: integers and booleans stop a gradient."""
    dtype = graph.dtype(name)
    return np.issubdtype(dtype, np.inexact) or dtype.kind == "V"  # V: bfloat16


def supported_ops() -> list[str]:
    """Names of the ops that have a rule, sorted."""
    return sorted(_RULES)
