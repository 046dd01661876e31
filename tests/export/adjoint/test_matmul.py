"""Rules of matrix products."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch

from .oracles import Case, check, rows

pytestmark = pytest.mark.torch

WEIGHT = np.random.default_rng(1).standard_normal((5, 6))


def gemm(turn_a: int, turn_b: int) -> Case:
    def function(a: torch.Tensor, b: torch.Tensor, c: torch.Tensor) -> torch.Tensor:
        return 0.5 * (a.T if turn_a else a) @ (b.T if turn_b else b) + 2 * c

    shapes = {"a": (4, 3) if turn_a else (3, 4), "b": (6, 4) if turn_b else (4, 6)}
    attrs = {"transA": turn_a, "transB": turn_b, "alpha": 0.5, "beta": 2.0}
    return Case(f"gemm_{turn_a}{turn_b}", "Gemm", shapes, function, attrs, {"c": np.arange(6.0)}, linear=True)


def einsum(equation: str, a: tuple[int, ...], b: tuple[int, ...]) -> Case:
    return Case(
        f"einsum_{equation}", "Einsum", {"a": a, "b": b}, lambda x, y: torch.einsum(equation, x, y),
        {"equation": equation}, opsets=(12, 13, 20), linear=True,
    )  # fmt: skip


CASES = [
    Case("matmul", "MatMul", {"a": (3, 4), "b": (4, 5)}, torch.matmul, linear=True),
    Case("matmul_weight", "MatMul", {"x": (2, 3, 5)}, torch.matmul, constants={"w": WEIGHT}, linear=True),
    Case(
        "matmul_weight_first",
        "MatMul",
        {"x": (2, 6, 4)},
        lambda x, w: w @ x,
        constants={"w": WEIGHT},
        order=["w", "x"],
        linear=True,
    ),
    Case(
        "matmul_batches",
        "MatMul",
        {"a": (2, 1, 3, 4), "b": (5, 4, 2)},
        torch.matmul,
        linear=True,
        dynamic_from=13,
    ),
    Case(
        "matmul_attention",
        "MatMul",
        {"a": (2, 3, 4, 5), "b": (2, 3, 5, 4)},
        torch.matmul,
        linear=True,
        dynamic_from=13,
    ),
    *(gemm(a, b) for a, b in itertools.product((0, 1), (0, 1))),
    *(
        einsum(*row)
        for row in (
            ("ij,jk->ik", (3, 4), (4, 5)),
            ("bchw,oc->bohw", (2, 3, 4, 5), (6, 3)),
            ("bhid,bhjd->bhij", (2, 3, 4, 5), (2, 3, 6, 5)),
            ("bhwc,hkc->bhwk", (2, 4, 5, 3), (4, 6, 3)),
            ("...ij,...jk->...ik", (2, 3, 4), (2, 4, 5)),
            ("...ij,jk", (2, 3, 4), (4, 5)),
            ("i,j->ij", (3,), (4,)),
            ("ij,ij->", (3, 4), (3, 4)),
            ("ijk,jl->il", (2, 3, 4), (3, 5)),
        )
    ),
    Case(
        "einsum_turned",
        "Einsum",
        {"x": (2, 3, 4, 5)},
        lambda x: x.permute(0, 2, 3, 1),
        {"equation": "bchw->bhwc"},
        opsets=(12, 17),
        linear=True,
    ),
    Case(
        "einsum_summed",
        "Einsum",
        {"x": (2, 3, 4)},
        lambda x: x.sum((1, 2)),
        {"equation": "b i j -> b"},
        opsets=(12, 17),
        linear=True,
    ),
    Case(
        "einsum_weight",
        "Einsum",
        {"x": (2, 3, 5)},
        lambda x, w: x @ w,
        {"equation": "bnc,cd->bnd"},
        {"w": WEIGHT},
        opsets=(12, 13, 17, 20),
        linear=True,
    ),
    Case(
        "einsum_three",
        "Einsum",
        {"a": (2, 3), "b": (3, 4), "c": (4, 2)},
        lambda *three: torch.einsum("ij,jk,ki->ik", *three),
        {"equation": "ij,jk,ki->ik"},
        opsets=(13,),
        linear=True,
    ),
    Case("gemm_plain", "Gemm", {"x": (3, 5)}, lambda x, w: x @ w, constants={"w": WEIGHT}, linear=True),
]


@rows(CASES)
def test_rule(case: Case, opset: int) -> None:
    check(case, opset)
