"""What the command says when something is wrong, what it leaves behind then, and what it says it wrote."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from elf_eval.command.main import build_parser, main
from elf_eval.data.images import ImageRef
from elf_eval.data.truth import Calibrated, Homography
from elf_eval.errors import EvalError
from elf_eval.methods import open_method
from elf_eval.metrics.families import metric_names
from elf_eval.metrics.pair import pair_metrics
from elf_eval.protocol import Protocol
from elf_eval.report import plots
from elf_eval.run.cache import extract

METHOD = "[[method]]\nname = '{}'\ndetector = '{}'\n"


@pytest.fixture
def command(hpatches_folder, tmp_path):
    """A quick run of SIFT into ``out/a``; options behind it go before."""
    where = ["--dataset", f"hpatches:{hpatches_folder}", "--detector", "sift", "--out", str(tmp_path / "out" / "a")]
    return ["run", *where, "--cache", str(tmp_path / "c"), "--quiet", "--size", "160x120", "--threads", "1"]


@pytest.fixture
def results(command, tmp_path, capsys):
    assert main(command) == 0
    capsys.readouterr()
    return str(tmp_path / "out" / "a" / "results.json")


def error_of(arguments, capsys):
    """The lines on stderr of a command that fails with an explanation."""
    assert main(arguments) == 1
    return capsys.readouterr().err.strip().removeprefix("elf-eval: error: ").removeprefix("elf-eval: ").splitlines()


@pytest.mark.parametrize(
    "wrong",
    [["--detector", "elff"], ["--dataset", "x=hpatches:nowhere"], ["--descriptor", "mser"]],
)
def test_a_run_that_fails_before_its_first_result_leaves_nothing(command, wrong, tmp_path):
    assert main([*command, *wrong]) == 1
    assert not (tmp_path / "out").exists()


def test_an_interrupted_command_goes_on_where_it_was(command, tmp_path, interrupted_at):
    calls = interrupted_at(3)
    assert main(command) == 130
    assert [path.name for path in (tmp_path / "out" / "a").iterdir()] == ["unfinished.jsonl"]
    assert main(command) == 0
    assert len(calls) == 3 + 2
    assert not (tmp_path / "out" / "a" / "unfinished.jsonl").exists()
    assert len(json.loads((tmp_path / "out" / "a" / "results.json").read_text())["pairs"]) == 4


@pytest.mark.parametrize("under", ["", "/deeper"])
def test_a_file_in_the_place_of_the_folder_is_found_before_any_work(command, results, under, tmp_path, capsys):
    (tmp_path / "file").write_text("in the way")
    cache = ["--cache", str(tmp_path / "new")]
    out = ["--out", f"{tmp_path / 'file'}{under}"]
    others = ["report", results, *out], ["images", command[2], *out]
    for arguments in ([*command, *out, *cache], *others):
        assert error_of(arguments, capsys) == [f"{tmp_path / 'file'} is not a folder"]
    assert not (tmp_path / "new").exists()


def test_a_folder_that_can_t_be_written_into_is_found_before_any_work(command, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(os, "access", lambda path, _: path != tmp_path)
    assert error_of(command, capsys) == [f"nothing can be written into the folder {tmp_path}"]
    assert not (tmp_path / "c").exists()


def test_unknown_metrics_are_named_with_those_there_are(results, capsys):
    for metrics in ("msx", "rep,msx"):
        (line,) = error_of(["compare", results, results, "--metrics", metrics], capsys)
        assert line.startswith("unknown metric 'msx'; these results have n1, n2, seen1, seen2, rep, ms, ")
        assert "_error" not in line
    (line,) = error_of(["compare", results, results, "--metrics", "rep,h_error"], capsys)
    assert line.startswith("h_error can't be averaged")


def test_a_metric_that_only_one_side_has_is_not_dropped(command, results, tmp_path, capsys):
    alone = [*command, "--out", str(tmp_path / "b")]
    alone[alone.index("sift")] = "gftt"
    assert main(alone) == 0
    capsys.readouterr()
    both = ["compare", results, str(tmp_path / "b" / "results.json"), "--method-a", "sift", "--method-b", "gftt"]
    assert main(both) == 0
    (line,) = error_of([*both, "--metrics", "rep,ms"], capsys)
    assert line == "nothing to compare by ms: no pair has it on both sides"


@pytest.mark.parametrize("metric", ["foo", "pose_auc@5"])
def test_a_sweep_checks_its_metric_before_any_work(metric, hpatches_folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("elf_eval.run.sweep.run", lambda *_, **__: pytest.fail("evaluated"))
    where = ["--model", "sobel", "--dataset", f"hpatches:{hpatches_folder}", "--cache", str(tmp_path / "c")]
    (line,) = error_of(["sweep", *where, "--metric", metric], capsys)
    assert line.startswith(f"unknown metric '{metric}'; a run on hpatches:{hpatches_folder} has n1, n2, ")
    assert line.endswith("h_inliers, h_auc@1, h_auc@3, h_auc@5")


def test_a_sweep_by_a_count_is_no_percentage(hpatches_folder, tmp_path, capsys):
    where = ["--model", "sobel", "--dataset", f"hpatches:{hpatches_folder}", "--cache", str(tmp_path / "c")]
    assert main(["sweep", *where, "--metric", "n1", "--size", "160x120", "--quiet"]) == 0
    assert 1 <= float(capsys.readouterr().out.splitlines()[-1].split()[0]) <= 500


def test_metric_names_are_those_of_a_pair(photo_file, tmp_path):
    found = extract(open_method("orb"), ImageRef("photo.png", photo_file), Protocol(size=None))
    np.save(tmp_path / "depth.npy", np.full((160, 200), 5.0, np.float32))
    camera, depth = (100.0, 0.0, 99.5, 0.0, 100.0, 79.5, 0.0, 0.0, 1.0), tmp_path / "depth.npy"
    pose = Calibrated(camera, camera, tuple(np.eye(4).ravel()))
    for truth in (Homography(), pose, Calibrated(camera, camera, pose.transform, depth, depth)):
        record = pair_metrics(found, found, truth, Protocol(size=None))
        assert metric_names(truth) == [name for name in record if not name.endswith("_error")]


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        *(("--size", text, "WIDTHxHEIGHT or source") for text in ("640", "0x480", "-640x480", "640x480x3")),
        *(("--max-keypoints", text, "a whole number from 1 on") for text in ("0", "-1", "many")),
    ],
)
def test_a_wrong_value_is_explained(command, option, value, words, capsys):
    with pytest.raises(SystemExit):
        main([*command, f"{option}={value}"])
    assert capsys.readouterr().err.splitlines()[-1].endswith(f"argument {option}: '{value}' is not {words}")


def test_the_system_s_errors_name_the_file_once(command, results, tmp_path, capsys):
    missing = str(tmp_path / "nofile")
    say = [f"{missing}: No such file or directory"]
    assert error_of(["run", missing, "--out", str(tmp_path / "o")], capsys) == say
    assert error_of(["report", missing], capsys) == say
    assert error_of(["compare", results, str(tmp_path)], capsys) == [f"{tmp_path}: not a file but a folder"]
    redraw = ["pareto", missing, results, "--image", missing, "--out", missing, "--redraw"]
    assert error_of(redraw, capsys) == [f"{missing}.json: No such file or directory"]
    (tmp_path / "d" / "i_light").mkdir(parents=True)
    (line,) = error_of([*command, "--detector", f"npz:{tmp_path / 'd'}"], capsys)
    assert line.endswith("1.png.npz: no features of i_light/1.png: No such file or directory")
    (tmp_path / "i" / "1.png").mkdir(parents=True)
    (tmp_path / "i" / "i_light").write_text("in the way")
    assert error_of(["images", command[2], "--out", str(tmp_path / "i")], capsys) == [
        f"{tmp_path / 'i' / 'i_light'}: File exists"
    ]


def test_a_picture_is_no_suite(photo_file, tmp_path, capsys):
    (line,) = error_of(["run", str(photo_file), "--out", str(tmp_path / "o")], capsys)
    assert line.startswith(f"{photo_file}: not a TOML file: ")


def test_h5_features_that_can_t_be_read(photo_file, tmp_path, monkeypatch):
    image = ImageRef("photo.png", photo_file).open(None)
    file = tmp_path / "f.h5"
    file.write_text("no features")
    method = open_method(f"h5:{file}")
    with monkeypatch.context() as changed:
        changed.setitem(sys.modules, "h5py", None)
        with pytest.raises(EvalError, match=r"h5py.* is not installed: pip install h5py$"):
            method.extract(image, 5)
    pytest.importorskip("h5py")
    with pytest.raises(EvalError, match=r"f\.h5: not an HDF5 file"):
        method.extract(image, 5)


def write_suite(path, folder, methods):
    head = "[variables]\nWHERE = 'models'\nDATA = '{}'\n[protocol]\nsize = [160, 120]\n[[dataset]]\nname = 'two'\n"
    path.write_text(head.format(folder) + "spec = 'hpatches:${DATA}'\n" + "".join(methods))
    return ["run", str(path), "--out", str(path.parent / "o"), "--cache", str(path.parent / "c"), "--quiet"]


def test_methods_that_can_t_be_opened_are_a_line_each(hpatches_folder, tmp_path, monkeypatch, capsys):
    methods = [METHOD.format(name, f"elf:${{WHERE}}/{name}.onnx") for name in ("A", "B")]
    run = write_suite(tmp_path / "s.toml", hpatches_folder, [*methods, METHOD.format("SIFT", "sift")])
    line = "method 'A': elf:models/A.onnx: ELF model: no such file: models/A.onnx (WHERE is models, from [variables])"
    assert error_of(run, capsys) == [line, line.replace("A", "B")]
    write_suite(tmp_path / "s.toml", hpatches_folder, [method + "optional = true\n" for method in methods])
    assert error_of(run, capsys) == ["none of the methods can be opened", line, line.replace("A", "B")]
    monkeypatch.setenv("WHERE", "there")
    assert error_of(run, capsys)[1].endswith("no such file: there/A.onnx (WHERE is there, from the environment)")
    assert not (tmp_path / "o").exists()


def test_a_method_that_is_left_out_is_told_and_stays_out_of_the_pages_paths(hpatches_folder, tmp_path, capsys):
    methods = [METHOD.format("A", "elf:${WHERE}/A.onnx") + "optional = true\n", METHOD.format("SIFT", "sift")]
    assert main(write_suite(tmp_path / "s.toml", hpatches_folder, methods)) == 0
    told = capsys.readouterr()
    assert "left out: method 'A': elf:models/A.onnx" in told.err
    assert "(WHERE is models, from [variables])" in told.err
    assert "no such file: ${WHERE}/A.onnx" in told.out


def test_a_dataset_that_can_t_be_opened_says_where_its_folder_comes_from(tmp_path, capsys):
    run = write_suite(tmp_path / "s.toml", "nowhere", [METHOD.format("SIFT", "sift")])
    line = "hpatches:nowhere: no such folder: nowhere (DATA is nowhere, from [variables])"
    assert error_of(run, capsys) == [line]


def test_a_variable_that_is_not_set_is_named(hpatches_folder, tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("NOT_THERE", raising=False)
    run = write_suite(tmp_path / "s.toml", hpatches_folder, [METHOD.format("A", "elf:${NOT_THERE}/A.onnx")])
    (line,) = error_of(run, capsys)
    assert "NOT_THERE is not set" in line


def test_pareto_names_the_method_that_is_not_here(hpatches_folder, photo_file, tmp_path, monkeypatch, capsys):
    (tmp_path / "features").mkdir()
    monkeypatch.setenv("WHERE", str(tmp_path / "gone"))
    run = write_suite(tmp_path / "s.toml", hpatches_folder, [METHOD.format("SIFT", "sift")])
    assert main(run) == 0
    write_suite(tmp_path / "s.toml", hpatches_folder, [METHOD.format("SIFT", "npz:${WHERE}")])
    where = [str(tmp_path / "s.toml"), str(tmp_path / "o" / "s" / "results.json"), "--image", str(photo_file)]
    capsys.readouterr()
    (line,) = error_of(["pareto", *where, "--out", str(tmp_path / "p")], capsys)
    gone = tmp_path / "gone"
    assert line == f"method 'SIFT': npz:{gone}: no such folder: {gone} (WHERE is {gone}, from the environment)"


def test_pareto_checks_the_picture_s_folder_before_it_times(results, tmp_path, capsys):
    where = ["pareto", "none.toml", results, "--image", "none.png", "--out", str(tmp_path / "p")]
    (line,) = error_of([*where, "--picture", str(tmp_path / "no" / "p.png")], capsys)
    assert line == f"--picture: there is no folder {tmp_path / 'no'}"


def test_a_seed_is_no_negative_number(capsys):
    with pytest.raises(SystemExit):
        main(["sweep", "--model", "sobel", "--dataset", "hpatches:x", "--seed=-1"])
    assert capsys.readouterr().err.endswith("argument --seed: '-1' is not a whole number from 0 on\n")


PICTURE = "[[picture]]\ndataset = 'two'\npair = 'v_turn/1.png - v_turn/3.png'\n"


@pytest.mark.parametrize("drawn", [True, False])
def test_the_last_line_names_what_was_written(hpatches_folder, tmp_path, drawn, monkeypatch, capsys):
    if drawn and not plots.available():
        pytest.skip("no matplotlib")
    monkeypatch.setattr(plots, "available", lambda: drawn)
    methods = [METHOD.format("SIFT", "sift"), PICTURE] if drawn else [METHOD.format("SIFT", "sift")]
    run = write_suite(tmp_path / "s.toml", hpatches_folder, methods)
    assert main(run) == 0
    folder = tmp_path / "o" / "s"
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1] == f"written: {tmp_path / 'o'}/README.md"
    named = lines[-2].removeprefix(f"written: {folder}/").split(", ")
    assert set(named) == {path.name + "/" * path.is_dir() for path in folder.iterdir()}
    assert {"plots/", "pictures/"} <= set(named) or not drawn
    again = tmp_path / "again"
    assert main(["report", str(folder / "results.json"), "--out", str(again)]) == 0
    line = capsys.readouterr().err.strip()
    assert line == f"written: {again}/README.md, tables.csv" + ", plots/" * drawn
    page = (folder / "README.md").read_text()
    assert "pip install" not in page
    assert ("matplotlib is not installed (it is in the extra 'eval')." in page) == (not drawn)


def test_a_picture_of_no_pair_is_an_error_before_anything_runs(hpatches_folder, tmp_path, capsys):
    wrong = PICTURE.replace("3.png", "9.png")
    run = write_suite(tmp_path / "s.toml", hpatches_folder, [METHOD.format("SIFT", "sift"), wrong])
    (line,) = error_of(run, capsys)
    assert line.startswith("picture 'v_turn/1.png - v_turn/9.png': no such pair in ")
    assert "which has '" in line
    assert not (tmp_path / "o").exists()
    assert not (tmp_path / "c").exists()


def test_every_option_has_its_help():
    (commands,) = (action for action in build_parser()._actions if action.choices)
    for name, parser in commands.choices.items():
        assert [action.dest for action in parser._actions if not action.help] == [], name
    assert "what to choose by (ms)" in commands.choices["sweep"].format_help()


@pytest.mark.parametrize(
    "change",
    [{"protocol": None}, {"versions": "x"}, {"datasets": None}, {"datasets": [1]}, {"methods": {"a": 1}}, {"pairs": 5}],
)
def test_odd_results_are_no_results(results, tmp_path, capsys, change):
    data = json.loads(Path(results).read_text())
    odd = tmp_path / "odd.json"
    for text in (json.dumps({**data, **change}), "null", "[]", "[" * 100_000, "{"):
        odd.write_text(text)
        assert error_of(["compare", results, str(odd)], capsys) == [f"{odd}: not a results file of elf-eval run"]
