"""Adjoint of Einsum, which is one again."""

from __future__ import annotations

import string
from dataclasses import dataclass

import onnx

from elf_export.adjoint.registry import Context, Gradients, adjoint
from elf_export.dialect.emit import shape_of, unsqueeze


@dataclass(frozen=True)
class Terms:
    """An equation's letters, one for each axis: of the operands and of the result; dots are letters too."""

    operands: tuple[str, ...]
    result: str


def _terms(ctx: Context) -> Terms | str:
    """The equation's terms, or why there are none."""
    equation = ctx.attrs["equation"].replace(" ", "")
    left, arrow, right = equation.partition("->")
    terms = left.split(",")
    if not arrow:
        letters = "".join(terms).replace("...", "")
        once = sorted(letter for letter in set(letters) if letters.count(letter) == 1)
        right = ("..." if "..." in left else "") + "".join(once)
    ranks = [ctx.graph.rank(name) for name in ctx.node.input]
    if len(terms) != len(ranks) or None in ranks:
        return "unknown rank of an input"
    free = [letter for letter in string.ascii_letters if letter not in equation]
    dots = [
        (rank or 0) - len(term.replace("...", "")) if "..." in term else 0
        for rank, term in zip(ranks, terms, strict=True)
    ]
    names = "".join(free[: max(dots, default=0)])
    operands = tuple(term.replace("...", names[len(names) - n :]) for n, term in zip(dots, terms, strict=True))
    return Terms(operands, right.replace("...", names))


def _supports(ctx: Context) -> str | None:
    terms = _terms(ctx)
    if isinstance(terms, str):
        return terms
    for term in (*terms.operands, terms.result):
        if len(set(term)) < len(term):
            return f"an index twice in {term!r}, a diagonal"
    sizes: dict[str, set[object]] = {}
    for name, term in zip(ctx.node.input, terms.operands, strict=True):
        for letter, size in zip(term, ctx.shape(name) or [], strict=True):
            sizes.setdefault(letter, set()).add(size)
    repeated = [letter for letter, found in sizes.items() if 1 in found and len(found) > 1]
    return f"the axis {repeated[0]!r} is repeated" if repeated else None


@adjoint("Einsum", since_opset=12, inputs=None, supports=_supports)
def einsum(ctx: Context, node: onnx.NodeProto, grad_y: str) -> Gradients:
    """Y[r] = sum A[a] B[b] ... over the indices that are not in r;  dA[a] = sum dY[r] B[b] ... over those not in a.

    Along an index that only A has, Y is a sum of A, and dA is the same for all its places.
    """
    terms = _terms(ctx)
    assert isinstance(terms, Terms)
    grads: list[str | None] = []
    for i, (name, term) in enumerate(zip(node.input, terms.operands, strict=True)):
        if not ctx.wanted[i]:
            grads.append(None)
            continue
        others = [j for j in range(len(node.input)) if j != i]
        given = [terms.result, *(terms.operands[j] for j in others)]
        had = "".join(letter for letter in term if letter in "".join(given))
        inputs = [grad_y, *(node.input[j] for j in others)]
        grad = ctx.op("Einsum", *inputs, role=f"d{i}", equation=f"{','.join(given)}->{had}")
        summed = [axis for axis, letter in enumerate(term) if letter not in had]
        if summed:
            grad = unsqueeze(ctx, grad, summed, f"d{i}_kept")
            grad = ctx.op("Expand", grad, shape_of(ctx, name, f"shape_{i}"), role=f"d{i}_repeated")
        grads.append(grad)
    return grads
