"""The figures of the authors' logs: rotation, scale and 3D viewpoint."""

from __future__ import annotations

import pytest

from elf_eval.errors import EvalError
from elf_eval.suite.paper import PAPER, TABLES
from elf_eval.suite.paper_logs import CURVES, LOGGED, VIEWPOINT, experiment, mean, scene_of
from elf_eval.suite.suite import DatasetEntry


def rounded(score):
    return tuple(round(value, 1) for value in score)


def test_every_method_has_every_view_and_pair():
    assert {kind: set(curves) for kind, curves in CURVES.items()} == {"scale": set(LOGGED), "rotation": set(LOGGED)}
    for curves in CURVES["scale"].values():
        assert list(curves) == [1.25, 1.5, 1.75, 2]
    for curves in CURVES["rotation"].values():
        assert list(curves) == [10, 50, 90, 130, 170, 210]
    pairs = {scene: {row: list(curve) for row, curve in curves.items()} for scene, curves in VIEWPOINT.items()}
    numbers = {"fountain-P11": 10, "entry-P10": 9, "Herz-Jesu-P8": 7}
    assert pairs == {s: {row: list(range(1, n + 1)) for row in LOGGED} for s, n in numbers.items()}
    scores = [s for curves in (*CURVES.values(), *VIEWPOINT.values()) for c in curves.values() for s in c.values()]
    assert len(scores) == 5 * (4 + 6 + 26)
    assert all(0 < ms <= rep < 100 for rep, ms in scores)


def test_known_values():
    elf = CURVES["scale"]["ELF-VGG"]
    assert [rounded(elf[f]) for f in (1.25, 1.5, 1.75, 2)] == [(74.9, 69.3), (70.8, 53.2), (67.2, 36.8), (64.8, 25.6)]
    assert rounded(CURVES["rotation"]["SIFT"][210]) == (68.3, 43.3)
    assert VIEWPOINT["entry-P10"]["ELF-VGG"][9] == (38.6, 10.0)
    assert VIEWPOINT["fountain-P11"]["SuperPoint"][2] == (61.3, 56.2)
    assert VIEWPOINT["Herz-Jesu-P8"]["LIFT"][7] == (16.5, 2.8)


def test_means_by_hand():
    assert mean([(10.0, 1.0), (20.0, 2.0), (60.0, 9.0)]) == (30.0, 4.0)
    reps = 73.0 + 69.1 + 57.3 + 53.6 + 58.8 + 44.7 + 41.5 + 44.3 + 38.6
    assert mean(VIEWPOINT["entry-P10"]["ELF-VGG"].values())[0] == pytest.approx(reps / 9)
    every = [score for curves in VIEWPOINT.values() for score in curves["ELF-VGG"].values()]
    assert rounded(mean(every)) == (44.2, 23.1)  # over pairs, not over scenes: those are of 10, 9 and 7
    scenes = {scene: rounded(mean(curves["ELF-VGG"].values())) for scene, curves in VIEWPOINT.items()}
    assert scenes == {"fountain-P11": (38.2, 18.1), "entry-P10": (53.4, 29.2), "Herz-Jesu-P8": (40.8, 22.3)}


def test_rows_of_the_logs_are_rows_of_the_paper():
    assert set(LOGGED) <= set(PAPER)
    assert TABLES["robustness"] == LOGGED
    assert {row for rows in TABLES.values() for row in rows} <= set(PAPER)


@pytest.mark.parametrize(
    ("folder", "scene"),
    [
        ("fountain-P11", "fountain-P11"),
        ("castle_entry_dense", "entry-P10"),
        ("entry_p10", "entry-P10"),
        ("Herz-Jesus-P8", "Herz-Jesu-P8"),
        ("herzjesu_dense", "Herz-Jesu-P8"),
        ("Herz-Jesu-P25", None),  # other images
        ("castle-P19", None),
        ("my fountain", None),
    ],
)
def test_a_scene_by_the_names_of_its_publishers(folder, scene):
    assert scene_of(folder) == scene


def test_the_experiment_that_a_dataset_is():
    assert experiment({"name": "x", "parameter": None}) == "generic"  # of older results
    assert experiment({"parameter": "scale", "paper": ""}) == "scale"
    assert experiment({"parameter": "rotation (degrees)"}) == "rotation"
    assert experiment({"parameter": None, "paper": "viewpoint"}) == "viewpoint"
    with pytest.raises(EvalError, match=r"dataset 'd': paper is one of .*'viewpoint'.*, not 'Strecha'"):
        DatasetEntry("d", "strecha:x", paper="Strecha")
