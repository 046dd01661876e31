"""Methods' names in plots: files without folders, and labels that leave the axes room."""

from __future__ import annotations

import warnings

import pytest

from elf_eval.report import plots
from elf_eval.report.method_names import without_folders, wrapped
from elf_eval.run.results import PairResult, Results
from elf_eval.suite.suite import TableEntry


def test_a_file_stands_without_its_folder_where_that_is_unambiguous():
    deep = "elf:/a/b/vgg.onnx?preset=paper"
    assert without_folders([deep, "elf:C:\\models\\alex.onnx", "sift", "elf?scale=1/2"]) == [
        "elf:vgg.onnx?preset=paper",
        "elf:alex.onnx",
        "sift",
        "elf?scale=1/2",
    ]
    both = ["elf:/a/vgg.onnx", "elf:/b/vgg.onnx"]
    assert without_folders(both) == both
    assert without_folders(["elf:/a/vgg.onnx", "elf:/b/vgg.onnx?scale=1"]) == [
        "elf:vgg.onnx",
        "elf:vgg.onnx?scale=1",
    ]
    assert without_folders([deep, deep]) == ["elf:vgg.onnx?preset=paper"] * 2


@pytest.mark.parametrize(
    ("name", "lines"),
    [
        ("SIFT", ["SIFT"]),
        ("FAST + ORB", ["FAST", "+ ORB"]),
        ("elf:vgg.onnx?preset=paper&scale=1", ["elf:vgg.onnx?", "preset=paper&", "scale=1"]),
        ("the paper: ELF-VGG int8", ["the paper: ELF-", "VGG int8"]),
        ("x" * 40, ["x" * 16, "x" * 16, "x" * 8]),
        ("a" * 16 + "b" * 16 * 8 + "c" * 16, ["a" * 16, "...", "b" * 16, "c" * 16]),
    ],
)
def test_a_long_name_is_wrapped_and_loses_its_middle(name, lines):
    assert wrapped(name, 16, 4) == "\n".join(lines)


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
