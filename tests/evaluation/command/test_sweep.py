"""`elf-eval sweep`."""

from __future__ import annotations

import json

import pytest
from command_line import error_of

from elf_eval.cli import main
from elf_eval.data import open_dataset
from elf_eval.methods import open_method
from elf_eval.methods.shared_maps import shared_runtime
from elf_runtime.model.network import Network
from helpers import TINY


def test_sweep_chooses_on_some_scenes_and_reports_on_others(hpatches_folder, tmp_path, capsys):
    grid = ["--grid", "nms_radius=4/10", "--grid", "denoise=3,1/5,5"]
    where = ["--dataset", f"hpatches:{hpatches_folder}", "--metric", "rep", "--size", "160x120", "--top", "2"]
    rest = ["--cache", str(tmp_path / "c"), "--quiet"]
    assert main(["sweep", "--model", "sobel", *grid, *where, *rest]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("5 settings")
    assert len(lines) == 2 + 3
    assert lines[-1].endswith("sobel")
    assert main(["sweep", "--model", "sobel", "--grid", "speed=3", *where, *rest]) == 1
    assert "unknown setting 'speed'" in capsys.readouterr().err


def test_a_sweep_leaves_its_table_and_the_same_as_data(hpatches_folder, tmp_path, capsys):
    where = ["--dataset", f"hpatches:{hpatches_folder}", "--metric", "rep", "--size", "160x120", "--top", "1"]
    command = ["sweep", "--model", "sobel", "--grid", "nms_radius=4/10", *where, "--cache", str(tmp_path / "c")]
    out = tmp_path / "new" / "o"
    assert main([*command, "--quiet", "--out", str(out)]) == 0
    printed = capsys.readouterr()
    assert (out / "sweep.txt").read_text() == printed.out
    assert printed.err.endswith(f"written: {out}/sweep.txt, sweep.json\n")
    found = json.loads((out / "sweep.json").read_text(), parse_constant=pytest.fail)
    assert found["command"].startswith("elf-eval sweep --model sobel")
    assert (found["metric"], found["settings"], found["protocol"]["size"]) == ("rep", 3, [160, 120])
    for trial, line in zip(found["trials"], printed.out.splitlines()[2:], strict=True):
        held, gain = trial["held_out"], trial["gain"]
        assert held["low"] is held["high"] is gain["p"] is None  # one scene has no interval
        assert line.split()[:3] == [f"{100 * trial['tuned']['mean']:.1f}", f"{100 * held['mean']:.1f}",
                                    f"{100 * gain['mean']:+.1f}"]  # fmt: skip
        count = trial["count"]
        assert line.split()[3:] == [f"{count['mean']:.0f}", f"({count['least']})", trial["text"]]
    (line,) = error_of([*command, "--out", str(out / "sweep.txt")], capsys)
    assert line == f"{out / 'sweep.txt'} is not a folder"


def test_sweeps_count_the_settings_of_a_range(hpatches_folder, tmp_path, capsys):
    grid = ["--grid", "nms_radius=4..6", "--grid", "denoise=3..5..2,1..2"]
    where = ["--dataset", f"hpatches:{hpatches_folder}", "--metric", "rep", "--size", "160x120", "--top", "2"]
    assert main(["sweep", "--model", "sobel", *grid, *where, "--cache", str(tmp_path / "c"), "--quiet"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("13 settings")
    assert "nan" not in "".join(lines)


@pytest.mark.parametrize("metric", ["foo", "pose_auc@5"])
def test_a_sweep_checks_its_metric_before_any_work(metric, hpatches_folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("elf_eval.run.sweep.run", lambda *_, **__: pytest.fail("evaluated"))
    where = ["--model", "sobel", "--dataset", f"hpatches:{hpatches_folder}", "--cache", str(tmp_path / "c")]
    (line,) = error_of(["sweep", *where, "--metric", metric], capsys)
    assert line.startswith(f"unknown metric '{metric}'; a run on hpatches:{hpatches_folder} has n1, n2, ")
    assert "h_inliers, h_auc@1, h_auc@3, h_auc@5" in line


def test_a_sweep_by_a_count_is_no_percentage(hpatches_folder, tmp_path, capsys):
    where = ["--model", "sobel", "--dataset", f"hpatches:{hpatches_folder}", "--cache", str(tmp_path / "c")]
    assert main(["sweep", *where, "--metric", "n1", "--size", "160x120", "--quiet"]) == 0
    assert 1 <= float(capsys.readouterr().out.splitlines()[-1].split()[0]) <= 500


def test_a_seed_is_no_negative_number(capsys):
    with pytest.raises(SystemExit):
        main(["sweep", "--model", "sobel", "--dataset", "hpatches:x", "--seed=-1"])
    assert capsys.readouterr().err.endswith("argument --seed: '-1' is not a whole number from 0 on\n")


def test_a_sweep_by_equal_counts_alone_is_refused_before_any_work(hpatches_folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("elf_eval.run.sweep.run", lambda *_, **__: pytest.fail("evaluated"))
    where = ["--model", "sobel", "--dataset", f"hpatches:{hpatches_folder}", "--cache", str(tmp_path / "c")]
    (line,) = error_of(["sweep", *where, "--counts", "equal"], capsys)
    assert line == "a sweep chooses by each method's own counts: --counts own, or leave it out"


def test_a_sweep_runs_the_network_once_for_each_image(hpatches_folder, tmp_path, monkeypatch, capsys):
    begun = []
    run = Network.run
    monkeypatch.setattr(
        Network, "run", lambda self, images, *rest, **more: begun.append(1) or run(self, images, *rest, **more)
    )
    shared_runtime.cache_clear()
    model = tmp_path / "tiny.onnx"
    model.write_bytes(TINY.read_bytes())
    where = ["--dataset", f"hpatches:{hpatches_folder}", "--size", "160x120", "--quiet", "--top", "1"]
    grid = ["--grid", "denoise=3..7..2,1..2", "--grid", "border=0"]
    command = ["sweep", "--model", f"elf:{model}", *grid, *where, "--cache", str(tmp_path / "c")]
    assert main([*command, "--beside", f"elf:{model}?preset=paper&border=4"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("7 settings")
    assert [line.split()[-1].rpartition("?")[2] for line in lines[3:-1]] == ["preset=paper&border=4"]
    assert len(begun) == 6  # images of both halves
    assert (
        main(
            [
                "run",
                "--dataset",
                f"two=hpatches:{hpatches_folder}",
                "--detector",
                f"elf:{model}?denoise=3,1&border=0",
                "--size",
                "160x120",
                "--quiet",
                "--out",
                str(tmp_path / "o"),
                "--cache",
                str(tmp_path / "c"),
            ]
        )
        == 0
    )
    assert len(begun) == 12  # features whose times are not their own are nobody else's


def test_shared_maps_give_the_same_features(hpatches_folder):
    image = next(iter(open_dataset(f"hpatches:{hpatches_folder}").images())).open((160, 120))
    for options in ("denoise=3,1&border=0", "scale=0.5&border=4&denoise=3,1", "denoise=5,2&border=0"):
        alone, shared = (open_method(f"elf:{TINY}?{options}", 1, shared=how) for how in (False, True))
        a, b = alone.extract(image, 60), shared.extract(image, 60)
        assert len(a)
        assert all((x == y).all() for x, y in zip(vars(a).values(), vars(b).values(), strict=True))
        assert alone.fingerprint != shared.fingerprint


def test_a_grid_is_of_elf_s_settings_alone(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("elf_eval.run.sweep.run", lambda *_, **__: pytest.fail("evaluated"))
    where = ["--dataset", f"hpatches:{tmp_path}", "--grid", "nms_radius=3/5"]
    (line,) = error_of(["sweep", "--model", "sobel", "--model", "sift", *where], capsys)
    assert line.startswith("sift: --grid is of ELF's settings, which elf:, sobel and laplacian take")
    assert "OpenCV" not in line
