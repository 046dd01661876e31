"""Features of another program that are declared to be at a method's keypoints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import error_of

from elf_eval.cli import main
from elf_eval.data import open_dataset
from elf_eval.errors import EvalError
from elf_eval.run import runner
from elf_eval.suite.file import load_suite
from elf_runtime.commands import detect
from helpers import TINY

OF_ELF = f"[[method]]\nname = 'ELF'\ndetector = 'elf:{TINY}?preset=paper-components'\n"
AT_ELF = "[[method]]\nname = 'at'\nkeypoints_of = 'ELF'\ndetector = 'npz:{folder}?frame=working'\n"
SIZE = ["--size", "160x120", "--threads", "1"]


@pytest.fixture
def described(hpatches_folder, tmp_path):
    """The suite's command, and the folder of the features: what elf-detect finds in the images of elf-eval images."""
    dataset = f"hpatches:{hpatches_folder}"
    images, found = str(tmp_path / "images"), tmp_path / "found"
    assert main(["images", dataset, "--size", "160x120", "--out", images]) == 0
    settings = ["--model", str(TINY), "--preset", "paper-components", "--threads", "1", "-q"]
    assert detect.main([images, "-r", "--base", images, "-o", str(found), *settings]) == 0
    for ref in open_dataset(dataset).images():
        name = Path(ref.name)
        (found / name.with_suffix(".npz")).rename(found / f"{ref.name}.npz")
    path = tmp_path / "s.toml"
    path.write_text(
        f"[[dataset]]\nname = 'two'\nspec = '{dataset}'\n{OF_ELF}{AT_ELF.format(folder=found)}", encoding="utf-8"
    )
    where = ["--out", str(tmp_path / "o"), "--cache", str(tmp_path / "c"), "--quiet"]
    return ["run", str(path), *where, *SIZE], found


def move(path: Path, pixels: float, count: int) -> None:
    """The first keypoints of a file, beside themselves."""
    with np.load(path) as file:
        data = dict(file)
    data["keypoints"][:count, 0] += np.float32(pixels)
    np.savez(path, **data)


def test_what_elf_detect_finds_are_the_method_s_keypoints(described):
    command, _ = described
    assert main(command) == 0


def test_foreign_keypoints_of_the_first_image_end_the_run_before_the_work(described, monkeypatch, capsys):
    command, folder = described
    first = min(folder.glob("*/1.*.npz"))
    move(first, 0.4, 1)
    assert main(command) == 0
    capsys.readouterr()
    move(first, 40.25, 2)
    extracted = []
    work = runner.extract_features
    monkeypatch.setattr("elf_eval.run.runner.extract_features", lambda e: extracted.append(e.ref.name) or work(e))
    (line,) = error_of(command, capsys)
    name = f"{first.parent.name}/{first.name.removesuffix('.npz')}"
    assert "method 'at': 2 of its " in line
    assert f"keypoints of {name} are not within 0.5 px of those of 'ELF'" in line
    assert set(extracted) == {name}


def test_foreign_keypoints_of_any_other_image_end_it_too(described, capsys):
    command, folder = described
    last = max(folder.glob("*/3.*.npz"))
    move(last, 30.25, 1)
    (line,) = error_of(command, capsys)
    assert "1 of its " in line
    assert f"{last.parent.name}/3." in line


def test_the_method_whose_keypoints_they_are_stands_above(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text(f"[[dataset]]\nname = 'd'\nspec = 'x'\n{AT_ELF.format(folder='f')}{OF_ELF}", encoding="utf-8")
    with pytest.raises(EvalError, match=r"method 'at': keypoints_of 'ELF' is no method above it"):
        load_suite(path)
