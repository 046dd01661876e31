"""The paper's suites, each on a made-up miniature of its data set."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import error_of
from publishers import write_features, write_publishers

from elf_eval.cli import main
from elf_eval.run.results import Results
from elf_eval.suite.file import load_suite
from elf_eval.suite.paper import TABLES

SUITES = Path(__file__).parents[3] / "evaluation" / "suites"
# Of each suite: its dataset, the methods of files of features, and what must be measured beside SIFT and ORB.
CASES = {
    "paper_hpatches": ("hpatches:{ELF_HPATCHES}", ["lfnet", "superpoint", "lift", "surf"], {"LF-Net", "SuperPoint"}),
    "paper_webcam": ("webcam:{ELF_WEBCAM}", ["lfnet", "superpoint", "lift", "surf"], {"LIFT", "SURF"}),
    "paper_rotation": ("rotation:{ELF_HPATCHES}?angles=10,50,90,130,170,210", ["lfnet", "lift"], {"LF-Net"}),
    "paper_scale": ("scale:{ELF_HPATCHES}", ["superpoint"], {"SuperPoint"}),
    "paper_strecha": ("strecha:{ELF_STRECHA}?pairs=first", ["lfnet"], {"LF-Net"}),
    "paper_components": ("hpatches:{ELF_HPATCHES}", ["surf", "lift-at-elf"], {"SURF", "ELF-VGG + LIFT"}),
    "paper_gradients": ("hpatches:{ELF_HPATCHES}", [], {"Sobel + AlexNet", "Laplacian + Xception"}),
}


@pytest.fixture
def variables(tmp_path, monkeypatch):
    root = tmp_path / "data"
    root.mkdir()
    found = write_publishers(root)
    for name, value in found.items():
        monkeypatch.setenv(name, value)
    return found


def run(name: str, out: Path, tmp_path: Path) -> list[str]:
    where = ["--out", str(out), "--cache", str(tmp_path / "c"), "--quiet", "--threads", "1"]
    return [
        "run",
        str(SUITES / f"{name}.toml"),
        *where,
        "--size",
        "320x240",
        "--max-keypoints",
        "60",
        "--count-floor",
        "20",
    ]


@pytest.mark.parametrize("name", sorted(CASES))
def test_a_suite_runs_on_its_data_set(name, variables, tmp_path):
    dataset, features, measured = CASES[name]
    write_features(variables, dataset.format(**variables), features)
    if name in ("paper_components", "paper_gradients"):  # the other data set may be absent
        Path(variables["ELF_WEBCAM"]).rename(tmp_path / "elsewhere")
    assert main(run(name, tmp_path / "out", tmp_path)) == 0
    page = (tmp_path / "out" / name / "README.md").read_text()
    results = Results.load(tmp_path / "out" / name / "results.json")
    assert measured | ({"ELF-VGG"} if "gradients" in name else {"ELF-VGG", "SIFT", "ORB"}) <= {
        m["name"] for m in results.methods
    }
    assert "in the paper" in page  # the miniature is no whole data set
    assert ("its columns are" in page) == (name != "paper_strecha")
    assert ("the paper's HPatches" in page) == (name not in ("paper_rotation", "paper_scale", "paper_strecha"))
    if name in ("paper_hpatches", "paper_webcam"):
        assert "Not measured: TILDE: npz:${ELF_FEATURES}/tilde?frame=working: no such folder" in page
        rows = [line.split("|")[1].strip() for line in page.splitlines() if line.startswith("| ")]
        assert set(TABLES["generic"]) <= set(rows)
    if name in ("paper_components", "paper_gradients"):
        assert "Not measured: Webcam" in page
    if name == "paper_components":
        assert "- / 53.7" in page  # SuperPoint with ELF's descriptor
    if name == "paper_strecha":
        found = results.of("Strecha", "SIFT", "own")
        assert {p.scene for p in found if "rep" in p.metrics} == {"fountain-P11"}
        assert all("epi_ms" in p.metrics for p in found)
        assert "ms by lines" in page
        assert "the paper's fountain-P11, 10 pairs |" in page  # of depth, beside rep and ms
        assert "| the paper: SuperPoint | 68.1 / 67.3 | 61.3 / 56.2 |" in page
        assert "| the paper: LIFT | 72.1 / 56.5 | 60.4 / 32.3 |" in page
    if name == "paper_scale":
        assert "| the paper: ELF-VGG | 74.9 / 69.3 | 70.8 / 53.2 | 67.2 / 36.8 | 64.8 / 25.6 |" in page
        assert "| LIFT | not measured |" in page
    if name == "paper_rotation":
        assert "| the paper: SIFT | 70.8 / 51.0 | 66.5 / 41.9 | 67.9 / 42.2 | 66.3 / 40.0 | 70.2 / 46.9 |" in page
        assert "| SuperPoint | not measured |" in page


def test_every_data_set_of_a_suite_exists_as_its_publishers_left_it(variables):
    opened = {Path(path).stem: load_suite(path) for path in sorted(SUITES.glob("*.toml"))}
    assert set(CASES) <= set(opened)
    assert [m.name for m in opened["paper_webcam"].methods] == [m.name for m in opened["paper_hpatches"].methods]
    assert {t.paper for t in opened["paper_hpatches"].tables} == {"generic", ""}


def test_the_gradients_with_three_networks_descriptors():
    suite = load_suite(SUITES / "paper_gradients.toml")
    described = {m.descriptor.partition("/")[2].partition(".")[0] for m in suite.methods if m.descriptor}
    assert described == {"elf-vgg", "elf-alexnet", "elf-xception"}
    assert {m.paper for m in suite.methods} == set(TABLES["gradients"])


def test_the_challenge_s_page_says_why_nothing_of_the_paper_stands_beside():
    suite = load_suite(SUITES / "paper_image_matching.toml")
    assert [d.paper for d in suite.datasets] == ["image matching"]
    assert "none stand beside" in suite.note


def test_what_is_missing_is_named_before_any_work(variables, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("elf_eval.run.runner._extract", lambda *_: pytest.fail("extracted"))
    image = Path(variables["ELF_HPATCHES"], "v_turn", "3.ppm")
    image.unlink()
    (line,) = error_of(run("paper_hpatches", tmp_path / "o", tmp_path), capsys)
    assert f"{image.parent}: expected one image 3.*" in line
    assert "ELF_HPATCHES is" in line
    monkeypatch.setenv("ELF_WEBCAM", str(tmp_path / "nowhere"))
    (line,) = error_of(run("paper_webcam", tmp_path / "o", tmp_path), capsys)
    assert "no such folder" in line


def test_a_missing_file_of_features_is_named_before_any_work(variables, tmp_path, capsys):
    dataset = f"hpatches:{variables['ELF_HPATCHES']}"
    write_features(variables, dataset, ["lift"])
    missing = Path(variables["ELF_FEATURES"], "lift", "v_turn", "2.ppm.npz")
    missing.unlink()
    command = ["run", "--dataset", dataset, "--detector", f"npz:{variables['ELF_FEATURES']}/lift", "--quiet"]
    (line,) = error_of([*command, "--out", str(tmp_path / "o"), "--cache", str(tmp_path / "c")], capsys)
    assert line.endswith(f"{missing}: no features of v_turn/2.ppm")


def test_of_several_suites_the_last_one_s_data_is_looked_for_first_of_all(variables, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("ELF_WEBCAM", str(tmp_path / "nowhere"))
    command = run("paper_hpatches", tmp_path / "o", tmp_path)
    (line,) = error_of([*command[:2], str(SUITES / "paper_webcam.toml"), *command[2:]], capsys)
    assert "no such folder" in line
    assert not (tmp_path / "o").exists()


def test_the_results_say_what_is_published(variables, tmp_path):
    assert main(run("paper_scale", tmp_path / "out", tmp_path)) == 0
    data = json.loads((tmp_path / "out" / "paper_scale" / "results.json").read_text())
    assert data["datasets"][0]["published"] == {"pairs": 464, "scenes": 116}
    assert data["datasets"][0]["paper"] == ""
    assert {m["name"]: m["paper"] for m in data["methods"]}["SIFT"] == "SIFT"
