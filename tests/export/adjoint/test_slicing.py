"""Rules of the ops that cut, join or pick pieces."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from .oracles import Case, check, rows

pytestmark = pytest.mark.torch

SHAPE = {"x": (2, 3, 5, 7)}
FAR = 2**63 - 1


def cut(
    name: str,
    function: Callable[[torch.Tensor], torch.Tensor],
    starts: list[int],
    ends: list[int],
    axes: list[int] | None,
    steps: list[int] | None,
    **more: Any,
) -> Case:
    bounds = {"starts": starts, "ends": ends, "axes": axes, "steps": steps}
    constants = {k: np.array(v, np.int64) for k, v in bounds.items() if v is not None}
    order = ["x", *(k if k in constants else "" for k in bounds)]
    while not order[-1]:
        order.pop()
    return Case(
        f"slice_{name}",
        "Slice",
        SHAPE,
        lambda x, *_: function(x),
        constants=constants,
        order=order,
        linear=True,
        **more,
    )


def pick(name: str, indices: object, axis: int, **more: Any) -> Case:
    index = np.array(indices, np.int64)

    def function(x: torch.Tensor, i: torch.Tensor) -> torch.Tensor:
        flat = x.index_select(axis, i.reshape(-1) % x.shape[axis])
        return flat.reshape(*x.shape[:axis], *index.shape, *x.shape[axis + 1 :])

    return Case(f"gather_{name}", "Gather", SHAPE, function, {"axis": axis}, {"i": index}, linear=True, **more)


CASES = [
    Case(
        "concat",
        "Concat",
        {"a": (2, 3, 4), "b": (2, 1, 4), "c": (2, 2, 4)},
        lambda *v: torch.cat(v, 1),
        {"axis": 1},
        linear=True,
    ),
    Case(
        "concat_last",
        "Concat",
        {"a": (2, 3, 4), "b": (2, 3, 1)},
        lambda *v: torch.cat(v, -1),
        {"axis": -1},
        linear=True,
    ),
    Case(
        "concat_static_axis",
        "Concat",
        {"a": (2, 3, 4), "b": (2, 2, 4)},
        lambda *v: torch.cat(v, 1),
        {"axis": 1},
        static_axes=(1,),
        linear=True,
    ),
    Case(
        "split_attr",
        "Split",
        SHAPE,
        lambda x: x[..., :3],
        {"axis": 3, "split": [3, 2, 2]},
        outputs=3,
        opsets=(11, 12),
        linear=True,
    ),
    Case(
        "split_input",
        "Split",
        SHAPE,
        lambda x, _s: x[..., :3],
        {"axis": -1},
        {"s": np.array([3, 2, 2])},
        outputs=3,
        opsets=(13, 17, 20),
        linear=True,
    ),
    Case(
        "split_even",
        "Split",
        {"x": (2, 6, 3)},
        lambda x: x[:, :2],
        {"axis": 1, "num_outputs": 3},
        outputs=3,
        opsets=(18, 20),
        linear=True,
        static_axes=(1,),
    ),
    cut("inside", lambda x: x[:, :, 1:4, 2:6], [1, 2], [4, 6], [2, 3], None),
    cut("no_axes", lambda x: x[1:, 0:2], [1, 0], [2, 2], None, None),
    cut("negative", lambda x: x[..., -4:-1], [-4], [-1], [-1], None),
    cut("clamped", lambda x: x[:, :, 2:], [2], [FAR], [2], None),
    cut("step_2", lambda x: x[..., ::2, 1::2], [0, 1], [FAR, FAR], [2, 3], [2, 2]),
    cut("step_3_cut", lambda x: x[..., 1:6:3], [1], [6], [3], [3]),
    cut("backwards", lambda x: x.flip(3), [-1], [-FAR], [3], [-1]),
    cut("backwards_step", lambda x: x.flip(3)[..., 1:6:2], [-2], [0], [3], [-2]),
    cut(
        "computed",
        lambda x: x[:, :, 1:4, 2:6:2],
        [1, 2],
        [4, 6],
        [2, 3],
        [1, 2],
        computed=("starts", "ends"),
        opsets=(11, 17),
    ),
    pick("computed", [4, -1, 0, 2], 2, computed=("i",), opsets=(11, 17)),
    pick("one", 1, 1),
    pick("one_axis_of_1", [2], 2),
    pick("negative", -1, 3),
    pick("several", [4, 0, 0, 2], 2),
    pick("last", [6, 1, 1, -3], 3),
    pick("first", [1, 0, 1], 0),
    pick("matrix", [[0, 2, 1], [-1, 1, 0]], 1),
    pick("matrix_last", [[0, 2], [-1, 1]], 3),
]


@rows(CASES)
def test_rule(case: Case, opset: int) -> None:
    check(case, opset)
