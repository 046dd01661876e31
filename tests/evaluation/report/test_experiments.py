"""Which results the paper's figures are for."""

from __future__ import annotations

from dataclasses import replace

import pytest
from made_results import LINED, PLACED, PLANAR, POSED, pair, results

from elf_eval.errors import EvalError
from elf_eval.report.experiments import check_generic, check_viewpoint

PLANES = results([pair("a", 1, {**PLACED, **PLANAR})])
CAMERAS = [results([pair("a", 1, {**PLACED, **POSED})]), results([pair("a", 1, {**LINED, "epi_ms": 0.4})])]
SCALE = results([pair("a", 1, {**PLACED, **PLANAR}, parameter=1.5)], parameter="scale")


def test_bars_are_of_planes_without_a_parameter():
    check_generic(PLANES, "set")
    with pytest.raises(EvalError, match=r"^set: .*HPatches, Webcam .* not for scale; elf-eval figures curves is"):
        check_generic(SCALE, "set")
    for found in CAMERAS:
        with pytest.raises(EvalError, match=r"^set: .* not for scenes with cameras; elf-eval figures viewpoint is"):
            check_generic(found, "set")
    named = replace(PLANES, datasets=[{**PLANES.datasets[0], "paper": "viewpoint"}])
    with pytest.raises(EvalError, match=r"not for viewpoint"):
        check_generic(named, "set")


def test_curves_over_images_are_of_cameras():
    for found in CAMERAS:
        check_viewpoint(found, "set")
    with pytest.raises(EvalError, match=r"^set: .*with cameras.*; elf-eval figures bars is"):
        check_viewpoint(PLANES, "set")
    with pytest.raises(EvalError, match=r"elf-eval figures curves is"):
        check_viewpoint(SCALE, "set")


def test_other_datasets_of_the_same_results_do_not_count():
    two = replace(
        PLANES,
        datasets=[*PLANES.datasets, {**PLANES.datasets[0], "name": "other"}],
        pairs=[*PLANES.pairs, *(replace(p, dataset="other") for p in CAMERAS[0].pairs)],
    )
    check_generic(two, "set")
    check_viewpoint(two, "other")
