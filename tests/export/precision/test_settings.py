"""`--set`: settings that a file carries, as a user gives them and as they are written down."""

from __future__ import annotations

from pathlib import Path

import pytest

from elf_export import ExportError
from elf_export.cli import main
from elf_export.command.options import parser, setting
from elf_export.detection import changed, chosen
from elf_export.request import Request
from elf_export.sources.networks import get_network
from elf_runtime import DetectionParams


def setting_words(settings: dict[str, object]) -> list[str]:
    program, *words = Request(net="vgg", detection=settings).words()
    assert (program, words[:2]) == ("elf-export", ["--net", "vgg"])
    return words[2:]


@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        ("scale=0.5", "scale", 0.5),
        ("nms_radius=6", "nms_radius", 6),
        ("denoise=5,1.2", "denoise", (5, 1.2)),
        (" denoise = 5 , 1.2 ", "denoise", (5, 1.2)),
        ("subpixel=true", "subpixel", True),
        ("subpixel=False", "subpixel", False),
        ("threshold=kapur", "threshold", "kapur"),
    ],
)
def test_settings_are_read(text: str, name: str, value: object) -> None:
    assert setting(text) == (name, value)
    assert type(setting(text)[1]) is type(value)


@pytest.mark.parametrize("text", ["scale", "=1", "scale=", "denoise=5,", ""])
def test_settings_that_are_none(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parser().parse_args(["--net", "vgg", "--set", text])
    assert f"{text!r} is not NAME=VALUE" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sale=1", "unknown detection setting 'sale'; known are"),
        ("scale=9", r"scale is a number in (0, 8], not 9"),
        ("scale=large", r"scale is a number in (0, 8], not 'large'"),
        ("denoise=4,1", "denoise is (mu, sigma) with mu odd"),
        ("subpixel=1", "subpixel is True or False, not 1"),
    ],
)
def test_settings_out_of_range(tmp_path: Path, text: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Before anything is computed."""
    assert main(["--net", "vgg", "--offline", "--set", text, "-o", str(tmp_path / "a.onnx")]) == 1
    assert message in capsys.readouterr().err


def test_settings_become_the_options_that_say_them() -> None:
    own = get_network("vgg").detection
    for changes in ({}, {"scale": 0.33}, {"denoise": (7, 1.8), "subpixel": True}, {"threshold": 0.25, "border": 0}):
        wanted = own.updated(**changes)
        words = setting_words(changed(own, wanted))
        assert len(words) == 2 * len(changes)
        args = parser().parse_args(["--net", "vgg", *words])
        assert own.updated(**dict(args.set)) == wanted
    assert isinstance(own, DetectionParams)


def test_options_say_what_differs_from_the_network_s_own_settings_to_the_last_digit() -> None:
    own = DetectionParams(denoise=(9, 3.0), border=4)
    assert setting_words(changed(own, own)) == []
    assert setting_words(changed(own, own.updated(border=10, subpixel=True))) == [
        "--set",
        "border=10",
        "--set",
        "subpixel=true",
    ]
    wanted = own.updated(scale=1 / 3, denoise=(7, 1.8000001), threshold=0.1 + 0.2)
    args = parser().parse_args(["--net", "vgg", *setting_words(changed(own, wanted))])
    assert own.updated(**dict(args.set)) == wanted


def test_settings_are_all_or_changes_to_the_network_s_own() -> None:
    own = DetectionParams(denoise=(9, 3.0), border=4)
    assert chosen(own, None) == chosen(own, {}) == own
    assert chosen(own, {"scale": 0.5}) == DetectionParams(denoise=(9, 3.0), border=4, scale=0.5)
    assert chosen(own, DetectionParams(scale=0.5)) == DetectionParams(scale=0.5)
    with pytest.raises(ExportError, match="border is an integer >= 0, not -1"):
        chosen(own, {"border": -1})
