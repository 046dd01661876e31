"""The front, what `elf-eval pareto` writes, and labels that cover nothing."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from elf_eval.bench.measurement import METRICS
from elf_eval.bench.pareto import Point, Study, front
from elf_eval.command.main import main
from elf_eval.errors import EvalError
from elf_eval.methods import open_method
from elf_eval.report import plots
from elf_eval.report.labels import choose
from elf_eval.report.pareto import markdown
from elf_eval.run.averages import Keypoints
from elf_runtime.checks.statistics import Interval
from elf_runtime.model.session import bundled_model

SUITE = """
[protocol]
size = [160, 120]
max_keypoints = 60
[[dataset]]
name = "two"
spec = "hpatches:{folder}"
[groups]
light = ["i_light"]
place = ["v_turn", "v_absent"]
[[method]]
name = "SIFT"
detector = "sift"
[[method]]
name = "a.b ORB"
detector = "orb"
family = "binary"
[[method]]
name = "no descriptors"
detector = "sobel?nms_radius=20"
"""


def point(name: str, time: float, score: float | None) -> Point:
    quality = {metric: score if metric == "ms" else 0.5 for metric in METRICS}
    return Point(name, "f", Interval(time, time, time), Interval(1, 1, 1), Keypoints(5.0, 4), quality, {})


def test_the_front_is_what_none_beats_in_both():
    rng = np.random.default_rng(0)
    points = [point(str(i), *rng.integers(1, 30, 2).astype(float)) for i in range(60)]
    found = front([*points, point("no score", 0.1, None)])
    times, scores = [p.milliseconds.value for p in found], [p.score for p in found]
    assert times == sorted(set(times))
    assert scores == sorted(set(scores))

    def beats(a, b):
        better = a.milliseconds.value < b.milliseconds.value or a.score > b.score
        return better and a.milliseconds.value <= b.milliseconds.value and a.score >= b.score

    assert not any(beats(a, b) for a in points for b in found)
    assert all(any(beats(a, b) for a in found) or vars(b) in map(vars, found) or tied(b, found) for b in points)


def tied(b, found):
    return any(a.milliseconds == b.milliseconds and a.score == b.score for a in found)


@pytest.fixture
def measured(hpatches_folder, photo_file, tmp_path):
    """A suite, its results, and the command that measures it."""
    suite = tmp_path / "s.toml"
    suite.write_text(SUITE.format(folder=hpatches_folder))
    assert main(["run", str(suite), "--out", str(tmp_path), "--cache", str(tmp_path / "c"), "--quiet"]) == 0
    results = str(tmp_path / "s" / "results.json")
    quick = ["--image", str(photo_file), "--repeats", "2", "--warmup", "1", "--threads", "1"]
    return ["pareto", str(suite), results, *quick, "--out", str(tmp_path / "new" / "p")]


def test_one_command_writes_data_page_and_picture(measured, tmp_path, capsys):
    assert main(measured) == 0
    text = (tmp_path / "new" / "p.json").read_text()
    data = json.loads(text)
    assert str(tmp_path) not in text
    assert [p["name"] for p in data["points"]] == ["SIFT", "a.b ORB", "no descriptors"]
    assert data["points"][0]["ratio"]["value"] == 1.0
    assert data["points"][2]["quality"]["ms"] is None
    assert any(p["on_front"] for p in data["points"])
    assert data["about"]["image"] == "photo.png"
    assert (data["about"]["width"], data["about"]["height"]) == (160, 120)
    page = (tmp_path / "new" / "p.md").read_text()
    assert page in capsys.readouterr().out
    assert "| light (light) | place (turn, absent) |" in page
    results = json.loads((tmp_path / "s" / "results.json").read_text())
    lit = [p["metrics"]["ms"] for p in results["pairs"] if (p["scene"], p["method"]) == ("i_light", "SIFT")]
    assert f"| SIFT | {100 * np.mean(lit):.1f} | " in page
    assert (tmp_path / "new" / "p.png").exists() == plots.available()


def test_a_redrawn_page_is_the_same(measured, tmp_path):
    assert main(measured) == 0
    page = tmp_path / "new" / "p.md"
    before = page.read_text()
    page.unlink()
    assert main([*measured, "--redraw"]) == 0
    picture = "p.png" if plots.available() else None
    assert page.read_text() == before == markdown(Study.load(tmp_path / "new" / "p.json"), picture)


@pytest.mark.parametrize(
    ("change", "words"),
    [(["--reference", "SURF"], "no method 'SURF'"), (["--image", "none.png"], "none.png")],
)
def test_what_can_not_be_measured_is_named(measured, capsys, change, words, tmp_path):
    assert main([*measured, *change]) == 1
    assert words in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_other_data_is_refused(tmp_path):
    (tmp_path / "p.json").write_text('{"schema": 0}')
    with pytest.raises(EvalError, match=r"p\.json: schema 0"):
        Study.load(tmp_path / "p.json")
    (tmp_path / "p.json").write_text("[")
    with pytest.raises(EvalError, match=r"p\.json: not the data"):
        Study.load(tmp_path / "p.json")


def test_labels_cover_neither_one_another_nor_what_is_taken():
    rng = np.random.default_rng(1)
    at = rng.uniform(100, 700, (12, 2))
    halves = np.tile([[45.0, 12.0]], (12, 1))
    sides = np.array([(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1)], float)
    offsets = np.stack([np.concatenate([sides * (halves[0] + gap) for gap in (8.0, 20.0, 40.0)])] * 12)
    taken = np.concatenate([at - 7, at + 7], axis=1)
    inside = np.array([0.0, 0.0, 800.0, 800.0])
    centres = at + choose(at, halves, offsets, taken, inside)
    assert (centres - halves >= inside[:2]).all()
    assert (centres + halves <= inside[2:]).all()
    gaps = np.abs(centres[:, None] - centres[None])
    apart = (gaps >= 2 * halves[0]).any(axis=2)
    assert apart[~np.eye(12, dtype=bool)].all()
    assert (np.abs(centres[:, None] - at[None]) >= halves[0] + 7).any(axis=2).all()


def test_the_bundled_model_by_precision(tmp_path):
    prints = {p: open_method(f"elf?precision={p}", 1).fingerprint for p in ("fp32", "int8")}
    assert open_method("elf", 1).fingerprint == prints["int8"] != prints["fp32"]
    copy = shutil.copy(bundled_model("fp32"), tmp_path / "copy.onnx")
    assert open_method(f"elf:{copy}", 1).fingerprint == prints["fp32"]
    with pytest.raises(EvalError, match=r"precision=fp8.*fp32, int8"):
        open_method("elf?precision=fp8", 1)
    with pytest.raises(EvalError, match="unknown options"):
        open_method(f"elf:{copy}?precision=fp32", 1)
