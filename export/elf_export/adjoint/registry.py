"""The rule table: which op is differentiated how."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import onnx

from elf_export.graph.graph import Array, Dim, Graph, GraphView, attributes, is_standard

from .gradient import ADJOINT
from .gradient import Gradients as Gradients  # rules import it from here

MIN_OPSET = 11  # Slice, Pad, Clip and Resize take their bounds as inputs from here on

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


class Context:
    """What a rule may ask of the forward graph, and where it emits its nodes.

    Emitted nodes are named ``adj/<forward node>/<role>``, so that a profile pairs forward and backward.
    Shapes and dtypes are known of forward values only, not of what a rule has just emitted.
    """

    def __init__(
        self, graph: Graph, node: onnx.NodeProto, wanted: Sequence[bool] = (), channels_last: bool = False
    ) -> None:
        self.graph = graph
        self.node = node
        self.wanted = wanted  # which inputs need a gradient; a rule may skip the others
        self.channels_last = channels_last  # convolutions will run so: gradients in one piece, not in phases
        self.attrs = attributes(node)

    @property
    def opset(self) -> int:
        return self.graph.opset

    def op(self, op_type: str, *inputs: str, role: str | None = None, **attrs: Any) -> str:
        """Emit a node and return its (first) output."""
        return self.graph.op(op_type, *inputs, name=self.name(role or op_type.lower()), **attrs)

    def const(self, value: Any, role: str, like: str | None = None, dtype: np.dtype[Any] | None = None) -> str:
        """Emit a constant; of the dtype of the forward value `like`, or of `dtype`, if given."""
        dtype = self.graph.dtype(like) if like is not None else dtype
        return self.graph.const(value, self.name(role), dtype)

    def int64s(self, values: Sequence[int], role: str) -> str:
        return self.graph.int64s(values, self.name(role))

    def input(self, index: int) -> str:
        """Name of an optional input, empty if it is absent."""
        return str(self.node.input[index]) if index < len(self.node.input) else ""

    def value(self, name: str) -> Array | None:
        """The value of a constant input, None if it is computed."""
        return self.graph.constant(name)

    def shape(self, name: str) -> list[Dim] | None:
        return self.graph.shape(name)

    def rank(self, name: str) -> int:
        """Rank of a value, which `supports` has made sure is known."""
        rank = self.graph.rank(name)
        assert rank is not None, f"unknown rank of {name!r}"
        return rank

    def dtype(self, name: str) -> np.dtype[Any]:
        return self.graph.dtype(name)

    def name(self, role: str) -> str:
        """The name of what this node's adjoint emits in that role."""
        return f"{ADJOINT}{self.node.name or self.node.output[0]}/{role}"


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
