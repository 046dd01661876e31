"""The exporter's float64 evaluator computes every op that has a rule in float64, forward and backward."""

from __future__ import annotations

import numpy as np
import pytest
from onnx.reference import ReferenceEvaluator

from elf_export.checks.arithmetic import computes_in_double
from elf_export.checks.float64 import STAND_INS, in_double

from .every_case import CASES
from .oracles import Case, _as
from .runs import with_adjoint

pytestmark = pytest.mark.torch

# What the evaluator, or a stand-in of the exporter's, can't run: such a network is checked in float32.
CANNOT = {"stride_groups_dilated", "up_groups", "mean_both", "max_indices", "global_max_line", "tensorflow"}


def rounded(case: Case) -> list[str]:
    """Which of y and dx are not computed in float64."""
    model, rng = case.model(case.opsets[-1], False, np.float32), np.random.default_rng(0)
    feed = {name: case.draw(rng, shape) for name, shape in case.inputs.items()}
    feed |= {name: _as(case.constants[name], np.float64) for name in case.computed}
    first = next(iter(case.inputs))
    found = []
    for graph, output in ((model, "y"), (with_adjoint(model, first), "dx")):
        evaluator = ReferenceEvaluator(in_double(graph), new_ops=STAND_INS)

        def run(x: np.ndarray, evaluator: ReferenceEvaluator = evaluator, output: str = output) -> np.ndarray:
            with np.errstate(all="ignore"):
                return np.asarray(evaluator.run([output], {**feed, first: x})[0])

        if not computes_in_double(run, feed[first]):
            found.append(output)
        feed["seed"] = rng.standard_normal(run(feed[first]).shape)
    return found


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_nothing_goes_through_float32(case: Case) -> None:
    if case.name in CANNOT:
        with pytest.raises((ValueError, TypeError, NotImplementedError)):
            rounded(case)
    else:
        assert rounded(case) == []
