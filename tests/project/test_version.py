"""Every command says which version is installed, without the libraries that only some of its work needs."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable

import pytest

import elf_runtime
from helpers import ROOT

SCRIPTS = dict(
    re.findall(r'^(elf-\w+) = "([\w.]+):main"$', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.MULTILINE)
)


def test_there_are_nine_commands() -> None:
    names = ("bench", "detect", "eval", "export", "info", "localize", "match", "reconstruct", "view")
    assert set(SCRIPTS) == {f"elf-{name}" for name in names}


@pytest.mark.parametrize("command", SCRIPTS)
def test_version(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    main: Callable[[list[str]], int] = importlib.import_module(SCRIPTS[command]).main
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == f"{command} {elf_runtime.__version__}\n"
