"""The rule table: which op is differentiated how."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import onnx

from ..graph import Array, Dim, Graph, attributes

if TYPE_CHECKING:
    import numpy as np

Gradients = Sequence[str | None]
"""One value name per input of the node, None where an input gets no gradient."""

Rule = Callable[..., Gradients]
"""rule(ctx, node, *grad_y) -> Gradients; `grad_y` has one entry per output, None for an output nobody used."""

RuleT = TypeVar("RuleT", bound=Rule)


@dataclass(frozen=True)
class _Entry:
    rule: Rule
    since_opset: int
    supports: Callable[[Context], str | None] | None


_RULES: dict[str, _Entry] = {}
_NO_GRADIENT: set[str] = set()


class Context:
    """What a rule may ask of the forward graph, and where it emits its nodes.

    Emitted nodes are named ``adj/<forward node>/<role>``, so that a profile pairs forward and backward.
    """

    def __init__(self, graph: Graph, node: onnx.NodeProto, wanted: Sequence[bool] = ()) -> None:
        self.graph = graph
        self.node = node
        self.wanted = wanted  # which inputs need a gradient; a rule may skip the others
        self.attrs = attributes(node)

    @property
    def opset(self) -> int:
        return self.graph.opset

    def op(self, op_type: str, *inputs: str, role: str | None = None, **attrs: Any) -> str:
        """Emit a node and return its (first) output."""
        return self.graph.op(op_type, *inputs, name=self._name(role or op_type.lower()), **attrs)

    def const(self, value: Any, role: str, like: str | None = None) -> str:
        """Emit a constant; of the dtype of value `like` if given."""
        dtype = self.graph.dtype(like) if like is not None else None
        return self.graph.const(value, self._name(role), dtype)

    def int64s(self, values: Sequence[int], role: str) -> str:
        return self.graph.int64s(values, self._name(role))

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

    def _name(self, role: str) -> str:
        return f"adj/{self.node.name or self.node.output[0]}/{role}"


def adjoint(
    *ops: str, since_opset: int = 1, supports: Callable[[Context], str | None] | None = None
) -> Callable[[RuleT], RuleT]:
    """Register a rule for `ops`.

    Parameters
    ----------
    since_opset : int
        First opset that the rule understands.
    supports : function, optional
        ``supports(ctx)`` returns why this node can't be differentiated, or None if it can.

    Raises
    ------
    ValueError
        If an op has a rule already.
    """

    def register(rule: RuleT) -> RuleT:
        for op in ops:
            if op in _RULES or op in _NO_GRADIENT:
                raise ValueError(f"op {op!r} is registered already")
            _RULES[op] = _Entry(rule, since_opset, supports)
        return rule

    return register


def no_gradient(*ops: str) -> None:
    """Register `ops` as constant almost everywhere, or not differentiable by nature (Shape, Equal, Floor ...)."""
    for op in ops:
        if op in _RULES or op in _NO_GRADIENT:
            raise ValueError(f"op {op!r} is registered already")
        _NO_GRADIENT.add(op)


def rule_for(op: str) -> Rule:
    return _RULES[op].rule


def has_no_gradient(op: str) -> bool:
    return op in _NO_GRADIENT


def supported_ops() -> list[str]:
    """Names of the ops that have a rule, sorted."""
    return sorted(_RULES)


def why_unsupported(context: Context) -> str | None:
    """Why the context's node can't be differentiated, None if it can."""
    node = context.node
    if node.domain not in ("", "ai.onnx"):
        return f"domain {node.domain!r} is not standard ONNX"
    entry = _RULES.get(node.op_type)
    if entry is None:
        return "no rule"
    if context.opset < entry.since_opset:
        return f"the rule needs opset {entry.since_opset} or later"
    return entry.supports(context) if entry.supports else None
