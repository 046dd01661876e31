"""elf-match on the files that elf-detect writes: the same matches, and records that have to agree."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime import Features
from elf_runtime.commands.detect import main as detect
from elf_runtime.commands.match import main
from elf_runtime.results.features import load_record
from helpers import TINY

from .scenes import write_views

MODEL = ["--model", str(TINY), "--threads", "1"]
NAMES = ["1.png", "2.png", "3.png"]


@pytest.fixture
def features(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with features of three views, next to that of the images."""
    monkeypatch.chdir(tmp_path)
    write_views(tmp_path / "photos", NAMES)
    assert detect(["photos", "-o", "found", *MODEL, "--threshold", "none", "--picture"]) == 0
    return tmp_path / "found" / "photos"


def changed(path: Path, name: str, **record: object) -> None:
    """A copy of a feature file with another record."""
    old = load_record(path)
    assert old is not None
    Features.load(path).save(path.with_name(name), {**old, **record})


def test_features_match_as_their_images_do(features: Path, capsys: pytest.CaptureFixture[str]) -> None:
    more = ["--ransac", "homography"]
    assert main(["photos", *MODEL, "--threshold", "none", *more, "--json", "a.json", "--save", "a", "-o", "pa"]) == 0
    capsys.readouterr()
    assert main([str(features), *more, "--json", "b.json", "--save", "b", "-o", "pb"]) == 0
    assert capsys.readouterr().err == ""
    one, two = (json.loads(Path(name).read_text()) for name in ("a.json", "b.json"))
    for name in ("model_sha256", "network", "layer", "descriptor", "settings", "ratio", "ransac", "ransac_threshold"):
        assert one[name] == two[name], name
    assert (two["model"], two["provider"]) == (None, None)
    for first, second in zip(one["images"], two["images"], strict=True):
        assert {name: first[name] for name in ("sha256", "size", "keypoints")}.items() <= second.items()
        assert Path(second["features_of"]).name == Path(first["image"]).name
    for first, second in zip(one["pairs"], two["pairs"], strict=True):
        assert {**first, "a": "", "b": ""} == {**second, "a": "", "b": ""}
    for stem in ("1--2", "1--3", "2--3"):
        a, b = stem.split("--")
        with np.load(f"a/{a}.png--{b}.png.npz") as first, np.load(f"b/{a}.npz--{b}.npz.npz") as second:
            assert set(first) == set(second)
            for name in first:
                np.testing.assert_array_equal(first[name], second[name])
        pictures = [cv2.imread(name) for name in (f"pa/{a}.png--{b}.png.png", f"pb/{a}.npz--{b}.npz.png")]
        assert pictures[0].shape == pictures[1].shape
        # The titles differ, by the names of the files.
        np.testing.assert_array_equal(pictures[0][60:], pictures[1][60:])


def test_a_list_of_images_finds_their_features(features: Path) -> None:
    Path("pairs.txt").write_text("3.png 1.png\n2.npz 3.png\n")
    assert main([str(features), "--pairs", "pairs.txt", "--json", "m.json"]) == 0
    pairs = json.loads(Path("m.json").read_text())["pairs"]
    assert [(Path(p["a"]).name, Path(p["b"]).name) for p in pairs] == [("3.npz", "1.npz"), ("2.npz", "3.npz")]


def test_features_beside_an_image(features: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["photos/1.png", str(features / "2.npz"), *MODEL, "--threshold", "none", "--json", "-"]) == 0
    said = capsys.readouterr()
    mixed = json.loads(said.out)
    assert "warning" not in said.err
    assert main(["photos/1.png", "photos/2.png", *MODEL, "--threshold", "none", "--json", "-"]) == 0
    images = json.loads(capsys.readouterr().out)
    assert mixed["matches"] == images["matches"]
    assert len({image["sha256"] for image in images["images"]}) == 2
    assert [image["sha256"] for image in mixed["images"]] == [image["sha256"] for image in images["images"]]
    assert main(["photos/1.png", str(features), *MODEL, "--max-keypoints", "20"]) == 0
    error = capsys.readouterr().err
    assert error.startswith("elf-match: warning: ")
    assert error.endswith(f"1.npz and 2 more: other settings than the model {TINY}: max_keypoints, threshold\n")


def test_another_model_is_refused(features: Path, capsys: pytest.CaptureFixture[str]) -> None:
    changed(features / "2.npz", "2.npz", model_sha256="0" * 64)
    assert main([str(features)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "2.npz has descriptors of tiny relu2 (SHA-256 000000000000), but " in error
    assert "they can't be compared" in error
    assert main(["photos/1.png", str(features / "3.npz"), "--threads", "1"]) == 1
    assert "but the model bundled has those of" in capsys.readouterr().err


def test_other_settings_and_no_record_are_said(features: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings = load_record(features / "1.npz")["settings"]  # type: ignore[index]
    changed(features / "2.npz", "2.npz", settings=settings | {"nms_radius": 3}, ignore_exif=True)
    with np.load(features / "3.npz") as saved:
        arrays = {name: saved[name] for name in saved if name != "record"}
    np.savez_compressed(features / "3.npz", **arrays)
    (features / "3.png").unlink()  # the picture: without the record it would be an image
    assert main([str(features)]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].endswith(f"2.npz: other settings than {features / '1.npz'}: ignore_exif, nms_radius")
    assert lines[1].endswith("3.npz: no record of a model; taken to be the same")
    assert len(lines) == 2


def test_descriptors_of_another_length(features: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = Features.load(features / "1.npz")
    short = Features(whole.keypoints, whole.scores, whole.descriptors[:, :5].copy(), whole.image_size)
    short.save(features / "4.npz")
    assert main([str(features), "--json", "m.json"]) == 1
    assert capsys.readouterr().err.count("can't be compared") == 3
    pairs = json.loads(Path("m.json").read_text())["pairs"]
    assert [Path(p["b"]).name for p in pairs if "error" in p] == ["4.npz"] * 3
    assert main([str(features), "--pairs", "nearest:2"]) == 1
    assert "4.npz: its descriptors have another length than the others'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "status", "reason"),
    [
        (["--threshold", "none"], 2, "--threshold: all of these are feature files"),
        (["--set", "nms_radius=4"], 2, "--set: all of these are feature files"),
        (MODEL, 2, "--model: all of these are feature files"),
        (["--ransac", "essential"], 1, "no focal length in its EXIF data; give --K"),
    ],
)
def test_one_line_for_what_is_wrong(
    features: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], status: int, reason: str
) -> None:
    assert main([str(features / "1.npz"), str(features / "2.npz"), *arguments]) == status
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert reason in error


def test_a_picture_needs_the_images(features: Path, capsys: pytest.CaptureFixture[str]) -> None:
    two = [str(features / f"{i}.npz") for i in (1, 2)]
    (features.parents[1] / "photos" / "2.png").unlink()
    assert main([*two]) == 0
    assert main([*two, "-o", "m.png"]) == 1
    assert "2.png is not there" in capsys.readouterr().err
    cv2.imwrite("photos/2.png", np.zeros((64, 64), np.uint8))
    assert main([*two, "-o", "m.png"]) == 1
    assert "no longer of the size" in capsys.readouterr().err
    assert not Path("m.png").exists()


def test_a_damaged_file_is_named(features: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (features / "2.npz").write_bytes((features / "2.npz").read_bytes()[:400])
    assert main([str(features / "1.npz"), str(features / "2.npz")]) == 1
    assert "2.npz: not a feature file" in capsys.readouterr().err.splitlines()[-1]
    assert main([str(features / "1.npz"), "absent.npz"]) == 1
    assert "absent.npz: not a feature file: No such file" in capsys.readouterr().err
