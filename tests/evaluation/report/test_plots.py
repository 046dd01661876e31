"""Plots: how many keypoints, whole titles, and room for long names."""

from __future__ import annotations

import warnings

import pytest
from made_results import PLACED, pair, results

from elf_eval.report import plots
from elf_eval.run.results import PairResult, Results
from elf_eval.suite.suite import TableEntry


def texts_outside(figure):
    """Texts of a figure that reach beyond it, but for numbers at ticks, which are kept beyond an axis's ends."""
    import matplotlib.text

    figure.draw_without_rendering()
    width, height = figure.bbox.width, figure.bbox.height
    shown = [t for t in figure.findobj(matplotlib.text.Text) if any(map(str.isalpha, t.get_text()))]
    boxes = [(t.get_text(), t.get_window_extent()) for t in shown]
    return [text for text, b in boxes if b.x0 < -1 or b.y0 < -1 or b.x1 > width + 1 or b.y1 > height + 1]


@pytest.mark.parametrize("count", [1, 2, 10])
@pytest.mark.parametrize("kind", ["bars", "curves", "mma"])
def test_plots_say_how_many_keypoints_and_cut_no_title(kind, count, tmp_path, monkeypatch):
    if not plots.available():
        pytest.skip("matplotlib is not installed")
    from matplotlib.figure import Figure

    methods = [f"method {i}" for i in range(count)]
    pairs = [pair("s", n, PLACED, 217, method, "equal", parameter=float(n)) for method in methods for n in (1, 2)]
    found = results(pairs, parameter="degrees", counts=("equal",), count_floor=100)
    found.datasets[0]["name"] = "A dataset with quite a long name, as a folder's path would be"
    for i, p in enumerate(found.pairs):
        found.pairs[i] = PairResult(**{**vars(p), "dataset": found.datasets[0]["name"]})
    figures = []
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda self, *a, **k: (figures.append(self), save(self, *a, **k))[1])
    plots.plot(found, TableEntry("All", plot=kind), tmp_path / "01")
    (figure,) = figures
    assert texts_outside(figure) == []
    texts = " ".join(t.get_text() for t in figure.findobj(lambda a: hasattr(a, "get_text")))
    assert texts.count("217") >= count
    assert "at least 100" in " ".join(texts.split())


@pytest.mark.parametrize("plot", ["bars", "curves", "mma"])
def test_long_names_leave_the_axes_room(plot, tmp_path):
    if not plots.available():
        pytest.skip("matplotlib is not installed")
    names = [f"elf:{'/a-rather/deep_folder' * 12}/model-{i}.onnx?preset=paper&descriptor=pool4" for i in (1, 2)]
    metrics = {"n1": 5, "n2": 5, "rep": 0.5, "ms": 0.4, **{f"mma@{t}": 0.3 for t in range(1, 11)}}
    results = Results(
        protocol={"counts": ["own"], "max_keypoints": 5},
        methods=[{"name": name, "paper": None} for name in names],
        skipped=[],
        datasets=[{"name": "two", "parameter": "degrees"}],
        versions={},
        created="",
        pairs=[PairResult("two", "s", "1", "2", name, "own", v, metrics) for name in names for v in (0.0, 40.0)],
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # "constrained_layout not applied because axes sizes collapsed to zero"
        (path,) = plots.plot(results, TableEntry("All", plot=plot), tmp_path / "01")
    assert path.stat().st_size > 5000


@pytest.mark.parametrize("kind", ["curves", "mma"])
def test_twenty_methods_are_told_apart(kind, tmp_path, monkeypatch):
    if not plots.available():
        pytest.skip("matplotlib is not installed")
    from matplotlib.figure import Figure

    pairs = [pair("s", n, PLACED, method=f"m{i}", parameter=float(n)) for i in range(20) for n in (1, 2)]
    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda self, *_, **__: figures.append(self))
    plots.plot(results(pairs, parameter="degrees"), TableEntry("All", plot=kind), tmp_path / "01")
    lines = figures[0].axes[0].lines
    assert len(lines) == 20
    assert len({(line.get_color(), line.get_marker()) for line in lines}) == 20
    assert len({(line.get_color(), line.is_dashed()) for line in lines}) == 20
    dashed = [{**plots.style(number), "linestyle": "--"} for number in range(20)]  # as the paper's curves
    assert len({(look["color"], look["marker"]) for look in dashed}) == 20
    assert all(plots.style(number)["linestyle"] != "--" for number in range(20))
