"""Suites that are damaged."""

from __future__ import annotations

import re

import pytest
from command_line import error_of, write_suite

from elf_eval.cli import main
from elf_eval.suite.file import load_suite
from elf_eval.suite.suite import DatasetEntry, MethodEntry, Suite


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("[[method]]\nname='a'\ndetector='sift'", "at least one method and one dataset"),
        ("[[method]]\nname='a'\n[[dataset]]\nname='d'\nspec='x'", "detector"),
        ("speed = 3", "unknown ['speed']"),
        ("[protocol]\nsize = 3\n", "size"),
        ("[protocol]\nepsilon = 3\n", "epsilon"),
        ("[[table", "Expected"),
    ],
)
def test_a_damaged_suite_is_named(tmp_path, capsys, content, words):
    path = tmp_path / "s.toml"
    path.write_text(content)
    assert main(["run", str(path), "--out", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert words in error
    assert "s.toml" in error


METHOD = "[[method]]\nname='a'\ndetector='sift'\n"
DATASET = "[[dataset]]\nname='d'\nspec='hpatches:nowhere'\n"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("[method]\nname='a'\ndetector='sift'", "method: a suite has [[method]] above each, not {'name': 'a', "),
        ("method='sift'", "method: a suite has [[method]] above each, not 'sift'"),
        ("method=['sift']", "method: a suite has [[method]] above each, not ['sift']"),
        ("method=3", "method: a suite has [[method]] above each, not 3"),
        ("[[method]]\nname='a'", "[[method]] 1 ('a'): detector is missing"),
        ("[[method]]\nname='a'\ndetector=5", "[[method]] 1 ('a'): detector: expected text, found 5"),
        (METHOD + "optional='yes'", "[[method]] 1 ('a'): optional: expected true or false, found 'yes'"),
        (METHOD + "speed=5", "[[method]] 1 ('a'): unknown 'speed'; known are name, detector, "),
        (METHOD + "[[dataset]]\nname='d'\nspec=5", "[[dataset]] 1 ('d'): spec: expected text, found 5"),
        ("[[table]]\ntitle='t'\nmethods=5", "[[table]] 1 ('t'): methods: expected a list, found 5"),
        ("[[table]]\ntitle='t'\nmethods='ELF'", "[[table]] 1 ('t'): methods: expected a list, found 'ELF'"),
        ("[[picture]]\npair='a - b'", "[[picture]] 1: dataset is missing"),
        ("[variables]\nDD=5", "[variables]: DD: expected text, found 5"),
        ("[groups]\nview='v_graf'", "[groups]: view: expected a list, found 'v_graf'"),
        ("groups=4", "groups: a suite has [groups] above its lines, not 4"),
        ("[[protocol]]\neps=3", "protocol: a suite has [protocol] above its lines, not [{'eps': 3}]"),
        ("[protocol]\nspeed=3", "protocol: unknown 'speed'; known are size, "),
        ("[protocol]\nsize=[3]", "protocol: size is [width, height] or 'source', not [3]"),
        ("[protocol]\nsize='large'", "protocol: size is [width, height] or 'source', not 'large'"),
        (
            "[protocol]\nhomography={estimator='IMREAD_COLOR'}",
            "protocol: estimator is one of RANSAC, LMEDS, RHO, USAC_DEFAULT, ",
        ),
        ("[protocol]\npose={estimator='FOO'}", "protocol: estimator is one of RANSAC, LMEDS, RHO, USAC_DEFAULT, "),
        ("note=['x']", "note: expected text, found ['x']"),
        ("title=5", "title: expected text, found 5"),
    ],
)
def test_a_wrong_suite_is_one_error_before_any_work(tmp_path, monkeypatch, capsys, content, reason):
    monkeypatch.setattr("elf_eval.command.run.run", lambda *_, **__: pytest.fail("evaluated"))
    path = tmp_path / "s.toml"
    path.write_text(content)
    (line,) = error_of(["run", str(path), "--out", str(tmp_path / "o")], capsys)
    assert line.startswith(f"{path}: {reason}")
    assert not re.search("[A-Z][a-z]+Entry|Protocol", line)


def test_a_group_of_an_unknown_scene_is_refused_before_any_work(hpatches_folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("elf_eval.run.runner.open_methods", lambda *_, **__: pytest.fail("opened"))
    command = write_suite(tmp_path / "s.toml", hpatches_folder, [METHOD, "[groups]\nview=['nope']\n"])
    (line,) = error_of(command, capsys)
    assert line.startswith("[groups] view: none of ['nope'] is in the datasets; there are ['")


def test_an_empty_variable_is_not_put_into_texts():
    entries = [MethodEntry("a", "sift")], [DatasetEntry("d", "x")]
    assert Suite(*entries, variables={"E": "", "F": "models"}).unexpand("models/a") == "${F}/a"


def test_only_whole_paths_get_a_variable_s_name():
    """`ELF_SHARED=.` leaves the full stops."""
    entries = [MethodEntry("a", "sift")], [DatasetEntry("d", "synthetic:x")]
    suite = Suite(*entries, variables={"S": ".", "M": "./models", "T": "/data/"})
    text = "xfeat:./x.onnx: no ./models/a.onnx, my./b, ./models-2. Nor /data/c, /data, /database; a/data."
    named = "xfeat:${S}/x.onnx: no ${M}/a.onnx, my./b, ${S}/models-2. Nor ${T}/c, ${T}, /database; a/data."
    assert suite.unexpand(text) == named


def test_a_word_of_a_sentence_is_no_path():
    entries = [MethodEntry("a", "sift")], [DatasetEntry("d", "synthetic:x")]
    suite = Suite(*entries, variables={"ELF_FEATURES": "features", "ELF_SET": "colmap:photos", "DEEP": "data/deep"})
    text = "surf: not here, or read the features from disk. No features. features: none, (features), one for features"
    assert suite.unexpand(text) == text
    paths = "npz:features?a=b: no features/surf (features/lift); npz:features: none; colmap:photos: data/deep/a"
    named = "npz:${F}?a=b: no ${F}/surf (${F}/lift); npz:${F}: none; ${ELF_SET}: ${DEEP}/a"
    assert suite.unexpand(paths) == named.replace("${F}", "${ELF_FEATURES}")


PART = """
note = "Weights."
[variables]
MODELS = "models"
[protocol]
eps = 3
count_floor = 10
[[method]]
name = "a"
detector = "sift"
[[method]]
name = "b"
detector = "orb"
[[table]]
title = "All"
"""


def test_an_included_file_comes_first_and_the_own_one_goes_before(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "p.toml").write_text(PART)
    (tmp_path / "s.toml").write_text(
        "title = 'T'\nnote = 'Data.'\ninclude = ['parts/p.toml']\n[variables]\nDATA = 'd'\n[protocol]\neps = 5\n"
        "[[dataset]]\nname = 'd'\nspec = 'x'\n[[method]]\nname = 'c'\ndetector = 'fast'\n"
        "[[method]]\nname = 'a'\ndetector = 'kaze'\n[[table]]\ntitle = 'All'\nplot = 'mma'\n"
    )
    suite = load_suite(tmp_path / "s.toml")
    assert [(m.name, m.detector) for m in suite.methods] == [("a", "kaze"), ("b", "orb"), ("c", "fast")]
    assert (suite.title, suite.note) == ("T", "Data.\n\nWeights.")
    assert (suite.protocol.eps, suite.protocol.count_floor) == (5, 10)
    assert suite.variables == {"MODELS": "models", "DATA": "d"}
    assert [t.plot for t in suite.tables] == ["mma"]


def test_an_error_names_the_included_file_and_a_circle_ends(tmp_path, capsys):
    part, own = tmp_path / "p.toml", tmp_path / "s.toml"
    own.write_text(f"include = ['p.toml']\n{METHOD}{DATASET}")
    part.write_text("[protocol]\nspeed = 3")
    (line,) = error_of(["run", str(own), "--out", str(tmp_path / "o")], capsys)
    assert line.startswith(f"{part}: protocol: unknown 'speed'")
    part.write_text("include = ['s.toml']")
    (line,) = error_of(["run", str(own), "--out", str(tmp_path / "o")], capsys)
    assert line.endswith("it includes itself")
    part.unlink()
    (line,) = error_of(["run", str(own), "--out", str(tmp_path / "o")], capsys)
    assert line.startswith(f"{part}: ")


def test_only_optional_datasets_may_be_absent(hpatches_folder, tmp_path, capsys):
    there = f"[[dataset]]\nname = 'two'\nspec = 'hpatches:{hpatches_folder}'\n"
    path, rest = tmp_path / "s.toml", ["--out", str(tmp_path / "o"), "--quiet", "--size", "160x120"]
    path.write_text(f"{METHOD}{there}{DATASET}optional = true\n")
    assert main(["run", str(path), *rest, "--cache", str(tmp_path / "c")]) == 0
    assert "Not measured: d: hpatches:nowhere: no such folder" in (tmp_path / "o" / "s" / "README.md").read_text()
    path.write_text(f"{METHOD}{DATASET}optional = true\n")
    capsys.readouterr()
    lines = error_of(["run", str(path), *rest], capsys)
    assert "none of the datasets is there" in lines[1]
    path.write_text(f"{METHOD}{there}published = {{ images = 3 }}\n")
    (line,) = error_of(["run", str(path), *rest], capsys)
    assert "published has pairs and scenes, not ['images']" in line
