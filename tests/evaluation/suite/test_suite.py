"""Suites that are damaged."""

from __future__ import annotations

import re

import pytest
from command_line import error_of, write_suite

from elf_eval.cli import main
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
