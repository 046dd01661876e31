"""elf-match on folders: which pairs it makes, what it writes, and what it refuses."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import cv2
import numpy as np
import pytest

from elf_runtime import ElfRuntime
from elf_runtime import match as matched
from elf_runtime.commands import match_views
from elf_runtime.commands.match import main
from helpers import TINY, textured

from .scenes import random_features, write_views

NAMES = ["1.png", "2.png", "10.png", "sub/3.png", "sub/4.png"]


@pytest.fixture
def photos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write_views(tmp_path / "photos", NAMES)
    return tmp_path / "photos"


def match(*arguments: object) -> int:
    return main([str(a) for a in arguments] + ["--model", str(TINY), "--threads", "1", "--threshold", "none"])


def pairs_of(*arguments: object) -> list[tuple[str, str]]:
    """The pairs of the JSON, as names below the folder."""
    assert match(*arguments, "--json", "m.json") == 0
    found = json.loads(Path("m.json").read_text())["pairs"]
    return [(pair["a"].removeprefix("photos/"), pair["b"].removeprefix("photos/")) for pair in found]


def in_order(names: list[str], reach: int) -> list[tuple[str, str]]:
    return [(names[i], names[j]) for i in range(len(names)) for j in range(len(names)) if i < j <= i + reach]


@pytest.mark.parametrize(
    ("which", "reach"), [((), 5), (("exhaustive",), 5), (("sequential",), 1), (("sequential:2",), 2)]
)
def test_pairs_by_order_of_names(photos: Path, which: tuple[str, ...], reach: int) -> None:
    option = ["--pairs", *which] if which else []
    assert pairs_of("photos", *option) == in_order(NAMES[:3], reach)
    assert pairs_of("photos", "-r", *option) == in_order(NAMES, reach)


def test_a_list_of_pairs(photos: Path) -> None:
    (photos / "with space.png").write_bytes((photos / "1.png").read_bytes())
    lines = ["# a comment", "10.png 1.png", "", "sub/4.png 1.png # another", "1.png 10.png", "with space.png\t2.png"]
    Path("pairs.txt").write_text("\n".join(lines))
    found = pairs_of("photos", "--pairs", "pairs.txt")
    assert found == [("10.png", "1.png"), ("sub/4.png", "1.png"), ("with space.png", "2.png")]


def test_one_against_a_folder(photos: Path) -> None:
    assert pairs_of("photos/2.png", "photos") == [("2.png", "1.png"), ("2.png", "10.png")]
    cv2.imwrite("query.png", cv2.imread("photos/10.png"))
    assert pairs_of("query.png", "photos", "-r") == [("query.png", name) for name in NAMES]
    assert pairs_of("query.png", "photos", "-r", "--pairs", "nearest:1") == [("query.png", "10.png")]


@pytest.mark.parametrize("count", [1, 2, 9])
def test_nearest_against_plain_loops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """Features around three groups of directions; likeness is worked out anew, in float64."""
    monkeypatch.chdir(tmp_path)
    groups = np.random.default_rng(0).standard_normal((3, 4, 8))
    found = [random_features(seed, groups[seed % 3]) for seed in range(7)]
    matrices = []
    for i, features in enumerate(found):
        features.save(f"{i}.npz")
        values, axes = np.linalg.eigh(np.cov(features.descriptors.T.astype(np.float64), bias=True))
        root = axes @ np.diag(values**0.25) @ axes.T
        matrices.append(root / np.sqrt((root * root).sum()))
    centred = [matrix - sum(matrices) / 7 for matrix in matrices]
    wanted = set()
    for i in range(7):
        likeness = []
        for j in range(7):
            if j != i:
                norms = np.sqrt((centred[i] ** 2).sum() * (centred[j] ** 2).sum())
                likeness.append((-(centred[i] * centred[j]).sum() / norms, j))
        for _, j in sorted(likeness)[:count]:
            wanted.add((f"{min(i, j)}.npz", f"{max(i, j)}.npz"))
    assert main([".", "--pairs", f"nearest:{count}", "--json", "m.json"]) == 0
    pairs = json.loads(Path("m.json").read_text())["pairs"]
    assert [(pair["a"], pair["b"]) for pair in pairs] == sorted(wanted)


def test_what_is_written_and_said(photos: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = ["-o", "out/pictures", "--save", "out/matches", "--json", "out/m.json"]
    assert match("photos", "--pairs", "sequential", "--ransac", "homography", *files) == 0
    stems = ["1.png--2.png", "2.png--10.png"]
    assert sorted(p.name for p in Path("out/pictures").iterdir()) == sorted(f"{stem}.png" for stem in stems)
    said = capsys.readouterr()
    assert said.err == ""
    *lines, last = said.out.splitlines()
    assert [line.partition(":")[0] for line in lines] == ["1.png, 2.png", "2.png, 10.png"]
    assert re.fullmatch(r"2 pairs in \d+\.\d s", last)
    document = json.loads(Path("out/m.json").read_text())
    assert document["pairs_by"] == "sequential"
    assert (document["ransac"], document["ransac_threshold"], document["ratio"]) == ("homography", 3.0, None)
    assert document["model_sha256"] == hashlib.sha256(TINY.read_bytes()).hexdigest()
    assert document["settings"]["threshold"] == "none"
    assert [image["image"] for image in document["images"]] == [f"photos/{name}" for name in NAMES[:3]]
    elf = ElfRuntime(TINY, threads=1)
    found = {name: elf.detect(photos / name, threshold="none") for name in NAMES[:3]}
    for image in document["images"]:
        path = Path(image["image"])
        assert image["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
        assert image["keypoints"] == len(found[path.name])
    for pair, stem in zip(document["pairs"], stems, strict=True):
        a, b = (found[Path(pair[side]).name] for side in "ab")
        with np.load(f"out/matches/{stem}.npz") as saved:
            np.testing.assert_array_equal(saved["pairs"], matched(a, b))
            assert saved["inliers"].sum() == pair["inliers"]
            np.testing.assert_array_equal(saved["matrix"], pair["matrix"])
        shift = np.array(pair["matrix"]) / pair["matrix"][2][2]
        np.testing.assert_allclose(shift[:2, 2], (-16, 0), atol=1.0)
        assert (pair["rotation"], pair["translation"], pair["K"]) == (None, None, None)


def test_no_two_pairs_have_files_of_one_name(photos: Path) -> None:
    """Names that differ in what stands for a folder, a hyphen or a percent sign only."""
    names = ["a/b.png", "a-b.png", "a%2Fb.png", "c--d.png", "c-%2Dd.png", "c---d.png"]
    write_views(Path("alike"), names)
    assert match("alike", "-r", "--save", "out", "--json", "m.json") == 0
    pairs = json.loads(Path("m.json").read_text())["pairs"]
    assert len(pairs) == 15
    for pair in pairs:
        first, second = (name.removeprefix("alike/") for name in (pair["a"], pair["b"]))
        (found,) = [p for p in Path("out").iterdir() if tuple(map(unquote, p.stem.split("--"))) == (first, second)]
        with np.load(found) as saved:
            assert len(saved["pairs"]) == pair["matches"]


def test_nothing_is_written_unasked(photos: Path) -> None:
    before = sorted(photos.parent.rglob("*"))
    assert match("photos", "-r") == 0
    assert sorted(photos.parent.rglob("*")) == before


@pytest.mark.parametrize("which", [(), ("--pairs", "nearest:2")])
def test_each_image_is_detected_once_in_little_memory(
    photos: Path, monkeypatch: pytest.MonkeyPatch, which: tuple[str, ...]
) -> None:
    assert match("photos", "-r", "--json", "all.json", *which) == 0
    detect, calls, kept = ElfRuntime.detect, [], []

    def counted(self: ElfRuntime, *arguments: Any, **settings: Any) -> Any:
        calls.append(1)
        return detect(self, *arguments, **settings)

    keep = match_views.Views._keep

    def watched(self: match_views.Views, *arguments: Any) -> None:
        keep(self, *arguments)
        kept.append(len(self._kept))

    monkeypatch.setattr(ElfRuntime, "detect", counted)
    monkeypatch.setattr(match_views.Views, "_keep", watched)
    monkeypatch.setattr(match_views, "MOST_BYTES", 1)
    assert match("photos", "-r", "--json", "few.json", *which) == 0
    assert len(calls) == len(NAMES)
    assert max(kept) == 2
    assert Path("few.json").read_text() == Path("all.json").read_text()


def test_a_pair_that_fails_is_said_once_and_the_others_go_on(photos: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (photos / "2.png").write_bytes(b"no image")
    for which, left_out in (((), "4 failed"), (("--pairs", "nearest:5"), "1 of the images left out")):
        assert match("photos", "-r", "--json", "m.json", *which) == 1
        said = capsys.readouterr()
        assert said.err == "elf-match: error: photos/2.png: not an image that OpenCV can decode: it is text\n"
        document = json.loads(Path("m.json").read_text())
        done = [(Path(p["a"]).name, Path(p["b"]).name) for p in document["pairs"] if "error" not in p]
        assert done == in_order(["1.png", "10.png", "3.png", "4.png"], 4)
        *lines, last, error = said.out.splitlines()
        assert len(lines) == len(done)
        assert re.fullmatch(rf"{len(document['pairs'])} pairs in \d+\.\d s, {left_out}:", last)
        assert error == "  photos/2.png: not an image that OpenCV can decode: it is text"
        assert [Path(image["image"]).name for image in document["images"] if "error" in image] == ["2.png"]
        failed = [p for p in document["pairs"] if "error" in p]
        assert len(failed) == (0 if which else 4)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["photos/1.png"], "give a second image or a folder"),
        (["absent"], "absent: give a second image or a folder"),
        (["photos", "photos/1.png"], "photos is a folder: give it alone, or as the second one"),
        (["photos/1.png", "photos/2.png", "--pairs", "exhaustive"], "--pairs goes with a folder"),
        (["photos/1.png", "photos/2.png", "-r"], "--recursive goes with a folder"),
        (["photos/1.png", "photos", "--pairs", "sequential"], "takes --pairs nearest:N or none"),
        (["photos", "--pairs", "nearest"], "--pairs nearest: not exhaustive"),
        (["photos", "--pairs", "nearest:0"], "--pairs nearest:0: not exhaustive"),
        (["photos", "--pairs", "sequential:x"], "--pairs sequential:x: not exhaustive"),
        (["photos", "--pairs", "absent.txt"], "--pairs absent.txt: not exhaustive"),
        (["photos", "--pairs", "photos"], "--pairs photos: not a file but a folder"),
        (["photos", "--pairs", "absent_name.txt"], "absent_name.txt, line 2: there is no 7.png in the folder photos"),
        (["photos", "--pairs", "three.txt"], "three.txt, line 1: two names are expected"),
        (["photos", "--pairs", "itself.txt"], "itself.txt, line 1: 1.png is paired with itself"),
        (["photos", "--pairs", "outside.txt"], "outside.txt, line 1: ../one.png is not below the folder photos"),
        (["photos", "--pairs", "none.txt"], "none.txt: there are no pairs in this file"),
        (["single"], "single: there is one image in this folder, 1.png"),
        (["single/1.png", "single"], "single: there is no other image in this folder than single/1.png"),
        (["empty"], "empty: no images"),
        (["photos", "-o", "photos"], "-o photos: its files would be taken for images next time"),
        (["photos", "-r", "--save", "photos/new"], "--save photos/new: its files would be taken for images"),
        (["photos", "-o", "m.png"], "-o m.png: of many pairs it is a folder"),
        (["photos", "-o", "photos"], "-o photos: its files would be taken for images"),
        (["photos", "--pairs", "none.txt", "--K", "500"], "--K goes with --ransac essential"),
    ],
)
def test_one_line_for_what_is_wrong(
    photos: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, arguments: list[str], reason: str
) -> None:
    monkeypatch.setattr(ElfRuntime, "detect", None)  # no image gets that far
    lists = {"absent_name": "1.png 2.png\n1.png 7.png", "three": "1.png 2.png 10.png", "itself": "1.png ./1.png"}
    lists |= {"outside": "1.png ../one.png", "none": "# nothing\n"}
    for name, text in lists.items():
        Path(f"{name}.txt").write_text(text)
    for folder in ("single", "empty"):
        Path(folder).mkdir()
    cv2.imwrite("single/1.png", textured(64, 64))
    before = sorted(photos.parent.rglob("*"))
    assert match(*arguments) == 2
    said = capsys.readouterr()
    assert said.err.startswith("elf-match: error: ")
    assert said.err.count("\n") == 1
    assert reason in said.err
    assert sorted(photos.parent.rglob("*")) == before


def test_an_output_that_is_a_file(photos: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("out").write_text("a file")
    assert match("photos", "--save", "out") == 1
    assert "--save: out is not a folder" in capsys.readouterr().err
