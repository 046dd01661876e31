"""Data sets that are half there: what is whole is used, and what is missing is named."""

from __future__ import annotations

import shutil

import pytest
from command_line import error_of
from publishers import write_publishers

from elf_eval.cli import main
from elf_eval.data import open_dataset
from elf_eval.errors import EvalError
from elf_eval.run.results import Results

METHOD = "[[method]]\nname = 'SIFT'\ndetector = 'sift'\n"


def test_of_an_optional_dataset_the_whole_scenes_are_measured(hpatches_folder, tmp_path, capsys):
    (tmp_path / "half").mkdir()
    for scene in hpatches_folder.iterdir():
        shutil.copytree(scene, tmp_path / "half" / scene.name)
    (image,) = (tmp_path / "half" / "v_turn").glob("3.*")
    image.unlink()
    half = f"[[dataset]]\nname = 'half'\nspec = 'hpatches:{tmp_path / 'half'}'\n"
    pictures = "".join(
        f"[[picture]]\ndataset = 'half'\npair = '{scene}/1.png - {scene}/2.png'\n" for scene in ("v_turn", "i_light")
    )
    path, rest = tmp_path / "s.toml", ["--quiet", "--size", "160x120", "--cache", str(tmp_path / "c")]
    path.write_text(f"{METHOD}{half}optional = true\n{pictures}")
    assert main(["run", str(path), "--out", str(tmp_path / "o"), *rest]) == 0
    page = (tmp_path / "o" / "s" / "README.md").read_text()
    assert "Not measured: half/v_turn: " in page
    assert "v_turn" in capsys.readouterr().err
    results = Results.load(tmp_path / "o" / "s" / "results.json")
    assert {p.scene for p in results.pairs} == {p.name for p in hpatches_folder.iterdir()} - {"v_turn"}
    assert len(list((tmp_path / "o" / "s" / "pictures").iterdir())) == 1
    path.write_text(f"{METHOD}{half}")  # not optional: nothing may be missing
    (line,) = error_of(["run", str(path), "--out", str(tmp_path / "p"), *rest], capsys)
    assert f"{tmp_path / 'half' / 'v_turn'}" in line


@pytest.mark.parametrize("kind", ["hpatches", "rotation", "scale", "webcam", "strecha"])
def test_scenes_that_are_not_whole_are_left_out_where_that_is_asked_for(kind, tmp_path):
    variables = write_publishers(tmp_path)
    which = {"webcam": "webcam", "strecha": "strecha"}.get(kind, "hpatches")
    root = tmp_path / which
    broken = sorted(root.iterdir())[0]
    gone = {"hpatches": "1.*", "webcam": "test/image_color/*", "strecha": "gt_dense_cameras/0001*"}[which]
    for path in broken.glob(gone):
        path.unlink()
    text = f"{kind}:{variables[f'ELF_{which.upper()}']}"
    with pytest.raises(EvalError, match=broken.name):
        open_dataset(text)
    incomplete = {}
    scenes = open_dataset(text, incomplete).scenes()
    assert scenes == sorted(p.name for p in root.iterdir() if p != broken)
    assert list(incomplete) == [broken.name]
    assert str(broken) in incomplete[broken.name]
    if kind not in ("strecha",):
        incomplete = {}
        assert open_dataset(f"{text}?scenes={scenes[0]},nowhere", incomplete).scenes() == scenes[:1]
        assert "no scene 'nowhere'" in incomplete["nowhere"]


@pytest.mark.parametrize("kind", ["webcam", "strecha"])
def test_a_scene_of_one_image_is_named(kind, tmp_path, capsys):
    write_publishers(tmp_path)
    first, *others = sorted((tmp_path / kind).iterdir())
    text = f"{kind}:{tmp_path / kind}"
    _leave_one(first)
    with pytest.raises(EvalError, match=rf"{first.name}.*: only one image here, .*; a scene's pairs need two$"):
        open_dataset(text)
    incomplete = {}
    assert open_dataset(text, incomplete).scenes() == [scene.name for scene in others]
    assert list(incomplete) == [first.name]
    for scene in others:
        _leave_one(scene)
    path = tmp_path / "s.toml"
    path.write_text(f"{METHOD}[[dataset]]\nname = 'D'\nspec = '{text}'\noptional = true\n")
    told = error_of(["run", str(path), "--out", str(tmp_path / "o"), "--quiet"], capsys)
    each = told[-len(others) - 1 :]
    assert told[-len(each) - 1].endswith("none of the datasets is there")
    assert all(f"/{kind}/" in line and "only one image here" in line for line in each)


def _leave_one(scene):
    for image in sorted(p for p in scene.rglob("*") if p.suffix in (".png", ".jpg"))[1:]:
        image.unlink()
