"""Commands that fail with an explanation, and small suites."""

from __future__ import annotations

from elf_eval.command.main import main


def error_of(arguments, capsys):
    """The lines on stderr of a command that fails with an explanation."""
    assert main(arguments) == 1
    return capsys.readouterr().err.strip().removeprefix("elf-eval: error: ").removeprefix("elf-eval: ").splitlines()


METHOD = "[[method]]\nname = '{}'\ndetector = '{}'\n"


def write_suite(path, folder, methods):
    head = "[variables]\nWHERE = 'models'\nDATA = '{}'\n[protocol]\nsize = [160, 120]\n[[dataset]]\nname = 'two'\n"
    path.write_text(head.format(folder) + "spec = 'hpatches:${DATA}'\n" + "".join(methods))
    return ["run", str(path), "--out", str(path.parent / "o"), "--cache", str(path.parent / "c"), "--quiet"]
