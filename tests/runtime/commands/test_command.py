"""What all commands share: errors, for people and, where JSON is asked for, for programs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from elf_runtime.commands import bench, detect, info, match, options
from helpers import TINY, textured

COMMANDS = {"elf-detect": detect, "elf-match": match, "elf-bench": bench, "elf-info": info}
ON_STDOUT = {name: ["--json"] if name in ("elf-info", "elf-match") else ["--json", "-"] for name in COMMANDS}


def words(name: str, folder: Path, model: str) -> list[str]:
    image = str(folder / "a.png")
    given = {
        "elf-detect": [image, "-o", str(folder / "out"), "--model", model],
        "elf-match": [image, image, "--model", model],
        "elf-bench": ["--sizes", "48x64", "--peers", "none", "--model", model],
        "elf-info": [model],
    }
    return given[name]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    import cv2

    cv2.imwrite(str(tmp_path / "a.png"), textured(48, 64))
    (tmp_path / "none.onnx").write_text("no model")
    return tmp_path


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("as_json", [False, True])
def test_a_failure_is_json_too_where_json_is_asked_for(
    name: str, as_json: bool, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = str(folder / "none.onnx")
    assert COMMANDS[name].main([*words(name, folder, model), *(ON_STDOUT[name] if as_json else [])]) == 1
    captured = capsys.readouterr()
    assert captured.err.startswith(f"{name}: error: {model}: not an ONNX model")
    reason = captured.err.partition("error: ")[2].rstrip("\n")
    assert captured.out == "" if not as_json else json.loads(captured.out) == {"error": reason}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_wrong_command_line_is_json_too(name: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = [*words(name, folder, str(TINY)), *ON_STDOUT[name]]
    with pytest.raises(SystemExit) as stopped:
        COMMANDS[name].main([*given, "--nonsense"])
    assert stopped.value.code == 2
    captured = capsys.readouterr()
    assert "usage: " in captured.err
    assert json.loads(captured.out) == {"error": "unrecognized arguments: --nonsense"}
    wrong = {"elf-info": ["--option", "x=1"], "elf-bench": ["--peers", "magic"]}
    assert COMMANDS[name].main([*given, *wrong.get(name, ["--set", "speed=1"])]) == 2
    captured = capsys.readouterr()
    assert json.loads(captured.out)["error"] == captured.err.partition("error: ")[2].rstrip("\n")


@pytest.mark.parametrize("name", ["elf-detect", "elf-match"])
@pytest.mark.parametrize("given", [[], ["--json"], ["--json", "-"]])
def test_a_command_line_that_ends_too_early(name: str, given: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        COMMANDS[name].main(given)
    assert stopped.value.code == 2
    assert (capsys.readouterr().out != "") == (given != [])


def test_a_file_that_json_goes_into_is_left_alone(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    summary = folder / "summary.json"
    summary.write_text("of an earlier run")
    given = words("elf-match", folder, str(folder / "none.onnx"))
    assert match.main([*given, "--json", str(summary)]) == 1
    assert capsys.readouterr().out == ""
    assert summary.read_text() == "of an earlier run"


def test_an_interruption_is_json_too(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("elf_runtime.commands.match_run.match", interrupted)
    assert match.main([*words("elf-match", folder, str(TINY)), "--json=-"]) == 130
    captured = capsys.readouterr()
    assert json.loads(captured.out) == {"error": "interrupted"}
    assert captured.err == "\nelf-match: interrupted\n"


def test_what_elf_info_can_say_of_a_foreign_model_comes_with_the_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    foreign = tmp_path / "foreign.onnx"
    foreign.write_bytes(TINY.read_bytes().replace(b"elf.", b"alf."))
    assert info.main([str(foreign), "--json"]) == 1
    captured = capsys.readouterr()
    report = json.loads(captured.out)
    assert report["graph"]["ops"]["MaxPool"] == 1
    assert report["error"].startswith(f"{foreign}: not an ELF model")
    assert f"elf-info: error: {report['error']}" in captured.err


@pytest.mark.parametrize(
    ("given", "on_stdout"),
    [
        (["--json", "-", "--json", "f.json"], False),
        (["--json=-", "--json=f.json"], False),
        (["--json", "f.json", "--json=-"], True),
        (["--json"], True),
        (["--json", "-q"], True),
        (["--json=F.JSON"], False),
    ],
)
def test_of_several_json_options_the_last_counts(
    given: list[str], on_stdout: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        match.main(["a.png", "b.png", "--nonsense", *given])
    assert (capsys.readouterr().out != "") == on_stdout


@pytest.mark.parametrize("name", COMMANDS)
def test_an_abbreviated_option_is_refused(name: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        COMMANDS[name].main([*words(name, folder, str(TINY)), "--js", "-"])
    assert "unrecognized arguments: --js" in capsys.readouterr().err


@pytest.mark.parametrize("name", COMMANDS)
def test_what_follows_json_is_no_input_that_would_be_lost(
    name: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (folder / "a.png").read_bytes()
    with pytest.raises(SystemExit):
        COMMANDS[name].main(["--json", str(folder / "a.png"), *words(name, folder, str(TINY))])
    assert "a.png' is no .json file; where it is an input, put --json behind it" in capsys.readouterr().err
    assert (folder / "a.png").read_bytes() == before


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        (["--max-keypoint", "3"], "--max-keypoints"),
        (["--max-keypoint=3"], "--max-keypoints"),
        (["--providr", "cuda"], "--provider"),
        (["--preset", "acurate"], "accurate"),
        (["--zzz"], None),
        (["--pask"], "--mask"),
        (["--versus"], "--version"),
        (["--kson"], "--json"),
        (["--max"], None),
        (["--preset", "zzz"], None),
    ],
)
def test_the_nearest_word_is_suggested(given: list[str], meant: str | None, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        detect.main(["a.png", "-o", "out", *given])
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("elf-detect: error: ")
    assert error.endswith(f"; did you mean {meant!r}?") if meant else "did you mean" not in error


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        (["--set", "normalise=0.9"], "normalize"),
        (["--descriptor", "pool11"], "pool1"),
        (["--provider", "openvin"], "openvino"),
    ],
)
def test_the_nearest_setting_layer_and_provider_are_suggested(
    given: list[str], meant: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert detect.main([*words("elf-detect", folder, str(TINY)), *given]) > 0
    assert capsys.readouterr().err.endswith(f"; did you mean {meant!r}?\n")


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completion_knows_the_options(name: str, shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("shtab")
    with pytest.raises(SystemExit) as stopped:
        COMMANDS[name].main(["--print-completion", shell])
    assert stopped.value.code == 0
    script = capsys.readouterr().out
    assert "provider-option" in script
    assert name in script


@pytest.mark.parametrize("name", COMMANDS)
def test_options_have_one_name_everywhere(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        COMMANDS[name].main(["--help"])
    text = capsys.readouterr().out
    for option in ("--version", "--print-completion", "--json [FILE]", "--provider NAME", "--provider-option"):
        assert option in text, option


def test_the_options_of_a_provider_reach_it(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = words("elf-detect", folder, str(TINY))
    assert detect.main([*given, "--provider-option", "x=1"]) == 2
    assert "--provider-option is for the provider that --provider names" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        detect.main([*given, "--provider", "cpu", "--provider-option", "nonsense"])
    assert "'nonsense' is not KEY=VALUE" in capsys.readouterr().err
    args = detect.build_parser().parse_args([*given, "--provider", "openvino", "--option", "a=1", "--option", "b=2=3"])
    assert options.provider(args) == ("openvino", {"a": "1", "b": "2=3"})
