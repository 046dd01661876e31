"""`elf-eval figures`: pictures of saliency, of matches, and of results."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from command_line import error_of
from publishers import write_publishers

from elf_eval.cli import main
from elf_eval.report import plots
from helpers import TINY

SMALL = ["--size", "160x120", "--threads", "1"]


def picture(arguments, path):
    assert main([*arguments, "-o", str(path)]) == 0
    found = cv2.imread(str(path))
    assert found is not None
    return found


def test_a_row_of_saliency_threshold_and_keypoints_for_each_model(photo_file, tmp_path):
    models = ["--model", f"elf:{TINY}?preset=paper", "--model", f"elf:{TINY}?preset=default"]
    command = ["figures", "layers", "--image", str(photo_file), *SMALL]
    whole = picture([*command, *models], tmp_path / "l.png")
    one = picture([*command, *models[:2]], tmp_path / "one.png")
    assert one.shape == (30 + 300, 3 * 400 + 2 * 6, 3)
    assert (whole[: one.shape[0]] == one).all()
    assert whole.shape[0] == 2 * one.shape[0] + 6
    heat, rest = one[30:, :400].astype(int), one[30:, 406:806].astype(int)
    assert (heat.max(axis=2) - heat.min(axis=2)).max() > 100  # in colours
    assert (rest == np.array([rest[..., 0]] * 3).transpose(1, 2, 0)).mean() > 0.5  # a grey image, what passes in colour
    crop = picture([*command, *models[:2], "--crop", "40,30,80,60"], tmp_path / "crop.png")
    assert crop.shape == one.shape
    enlarged = cv2.resize(one[30 + 75 : 30 + 225, 100:300], (400, 300), interpolation=cv2.INTER_CUBIC).astype(int)
    assert np.corrcoef(enlarged.ravel(), crop[30:, :400].ravel())[0, 1] > 0.9


def test_gradients_beside_a_network_s_saliency(photo_file, tmp_path):
    command = ["figures", "gradients", "--image", str(photo_file), "--model", f"elf:{TINY}?preset=paper", *SMALL]
    assert picture(command, tmp_path / "g.jpg").shape == (2 * 330 + 6, 4 * 400 + 3 * 6, 3)


def test_matches_of_a_pair_method_by_method(hpatches_folder, tmp_path):
    command = [
        "figures",
        "matches",
        "--dataset",
        f"hpatches:{hpatches_folder}",
        "--pair",
        "v_turn/1.png - v_turn/3.png",
    ]
    rest = ["--detector", "sift", "--detector", "orb", "--cache", str(tmp_path / "c"), *SMALL]
    found = picture([*command, *rest], tmp_path / "m.png")
    assert found.shape[0] > 2 * 120
    green = (found[..., 1].astype(int) - found[..., 2] > 60).mean()
    assert green > 0.001


@pytest.mark.skipif(not plots.available(), reason="matplotlib is not installed")
def test_figures_of_results(results, hpatches_folder, tmp_path, capsys):
    for name in ("bars", "components"):
        assert picture(["figures", name, results], tmp_path / f"{name}.png").std() > 5
    (line,) = error_of(["figures", "curves", results, "-o", str(tmp_path / "c.png")], capsys)
    assert "no angle or scale" in line
    (line,) = error_of(["figures", "viewpoint", results, "-o", str(tmp_path / "v.png")], capsys)
    assert "this figure is for scenes with cameras" in line
    (line,) = error_of(["figures", "bars", results, "-o", str(tmp_path / "c.nope")], capsys)
    assert line.startswith(f"{tmp_path / 'c.nope'}: ")


def test_a_picture_s_folder_is_made_and_checked_before_the_work(photo_file, tmp_path, monkeypatch, capsys):
    command = ["figures", "layers", "--image", str(photo_file), "--model", "sobel", *SMALL]
    assert picture(command, tmp_path / "new" / "folder" / "l.png").std() > 5
    monkeypatch.setattr("elf_eval.command.figures.open_method", lambda *_: pytest.fail("worked"))
    (line,) = error_of([*command, "-o", str(photo_file / "l.png")], capsys)
    assert line == f"{photo_file} is not a folder"


def test_what_can_t_be_drawn_is_one_error(photo_file, tmp_path, capsys):
    command = ["figures", "layers", "--image", str(photo_file), "-o", str(tmp_path / "l.png"), *SMALL]
    (line,) = error_of([*command, "--model", "sift"], capsys)
    assert line == "sift: a saliency map is of elf:FILE.onnx, sobel or laplacian"
    (line,) = error_of([*command, "--model", "sobel", "--crop", "100,100,100,100"], capsys)
    assert "160x120" in line


def test_a_missing_model_is_named_before_any_other_works(photo_file, hpatches_folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("elf_eval.command.figures.saliency_figures.seen_by", lambda *_: pytest.fail("worked"))
    monkeypatch.setattr("elf_eval.command.figures.FeatureCache.get", lambda *_: pytest.fail("worked"))
    out, missing = ["-o", str(tmp_path / "l.png"), *SMALL], f"elf:{tmp_path / 'no.onnx'}"
    for name in ("layers", "gradients"):
        models = ["--model", f"elf:{TINY}", "--model", missing]
        (line,) = error_of(["figures", name, "--image", str(photo_file), *models, *out], capsys)
        assert "no such file" in line
    pair = ["--dataset", f"hpatches:{hpatches_folder}", "--pair", "v_turn/1.png - v_turn/3.png"]
    (line,) = error_of(["figures", "matches", *pair, "--detector", "sift", "--detector", missing, *out], capsys)
    assert "no such file" in line


@pytest.mark.skipif(not plots.available(), reason="matplotlib is not installed")
def test_a_suite_says_whose_curves_stand_beside_whose(hpatches_folder, tmp_path, monkeypatch, capsys):
    """Results by hand, drawn and reported with the suite of the paper's scale."""
    where = ["--dataset", f"scale:{hpatches_folder}?factors=1.25,2", "--detector", "sift", "--out", str(tmp_path)]
    rest = ["--cache", str(tmp_path / "c"), "--quiet", "--size", "160x120", "--threads", "1"]
    assert main(["run", *where, *rest]) == 0
    assert "the paper" not in (tmp_path / "README.md").read_text()
    suite = tmp_path / "suite.toml"
    suite.write_text(
        "[[dataset]]\nname = 'scale'\nspec = 'x'\npublished = { scenes = 116 }\n"
        "[[method]]\nname = 'sift'\ndetector = 'sift'\npaper = 'SIFT'\n"
    )
    results = str(tmp_path / "results.json")
    colours = []
    draw = plots.draw_paper
    monkeypatch.setattr(plots, "draw_paper", lambda *a: (draw(*a), colours.append(a[0].lines[2].get_color())))
    picture(["figures", "curves", results], tmp_path / "alone.png")
    picture(["figures", "curves", results, "--suite", str(suite)], tmp_path / "joined.png")
    capsys.readouterr()
    for name in ("bars", "components"):
        (line,) = error_of(["figures", name, results, "-o", str(tmp_path / "b.png")], capsys)
        assert "not for scale; elf-eval figures curves is for those" in line
    assert colours == ["C2", "C2", "C0", "C0"]  # the paper's SIFT, its second, beside our only one
    assert main(["report", results, "--suite", str(suite)]) == 0
    page = (tmp_path / "README.md").read_text()
    assert "| the paper: SIFT | 72.5 / 51.4 | 70.4 / 50.7 |" in page
    assert "116 scenes in the paper: its columns are for orientation" in page


@pytest.mark.skipif(not plots.available(), reason="matplotlib is not installed")
def test_the_figure_of_viewpoint_is_of_cameras(tmp_path, capsys):
    variables = write_publishers(tmp_path)
    where = ["--dataset", f"strecha:{variables['ELF_STRECHA']}?pairs=first", "--detector", "sift", "--quiet"]
    assert main(["run", *where, "--cache", str(tmp_path / "c"), "--out", str(tmp_path / "o"), *SMALL]) == 0
    results = str(tmp_path / "o" / "results.json")
    capsys.readouterr()
    assert picture(["figures", "viewpoint", results], tmp_path / "v.png").std() > 5
    (line,) = error_of(["figures", "bars", results, "-o", str(tmp_path / "b.png")], capsys)
    assert "not for scenes with cameras; elf-eval figures viewpoint is for those" in line
