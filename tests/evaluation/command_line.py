"""Commands that fail with an explanation, and small suites."""

from __future__ import annotations

from elf_eval.cli import main


def error_of(arguments, capsys):
    """The lines on stderr of a command that fails with an explanation."""
    assert main(arguments) == 1
    return capsys.readouterr().err.strip().removeprefix("elf-eval: error: ").removeprefix("elf-eval: ").splitlines()


METHOD = "[[method]]\nname = '{}'\ndetector = '{}'\n"


def write_suite(path, folder, methods):
    head = "[variables]\nWHERE = 'models'\nDATA = '{}'\n[protocol]\nsize = [160, 120]\n[[dataset]]\nname = 'two'\n"
    path.write_text(head.format(folder) + "spec = 'hpatches:${DATA}'\n" + "".join(methods))
    return ["run", str(path), "--out", str(path.parent / "o"), "--cache", str(path.parent / "c"), "--quiet"]


def run_by_hand(hpatches_folder, tmp_path, name, *options):
    where = ["--dataset", f"two=hpatches:{hpatches_folder}", "--out", str(tmp_path / name)]
    rest = ["--cache", str(tmp_path / "c"), "--quiet", "--size", "160x120", *options]
    assert main(["run", *where, *rest]) == 0
    return str(tmp_path / name / "results.json")
