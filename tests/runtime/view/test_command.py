"""elf-view: what it takes, what it refuses in one line, and which keypoints it shows of results."""

from __future__ import annotations

import base64
import json
import re
import webbrowser
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from elf_runtime import ElfRuntime, Features
from elf_runtime.commands.detect import main as detect
from elf_runtime.commands.view import main
from elf_runtime.view.page import is_page
from elf_runtime.view.results import of_result
from elf_runtime.view.shown import quantization_step, small
from helpers import textured


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    folder = tmp_path / "photos"
    (folder / "sub").mkdir(parents=True)
    for seed, name in enumerate(("a.png", "b.jpg", "sub/c.png")):
        cv2.imwrite(str(folder / name), textured(120, 160, seed))
    return folder


def data(page: Path) -> list[dict[str, Any]]:
    """What the page holds of its images."""
    found = re.findall(r'<script type="application/json" class="image">(.*?)</script>', page.read_text())
    return [json.loads(text) for text in found]


def test_images_of_a_folder(photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "new" / "view.html"
    assert main([str(photos), "-o", str(page), "--max-keypoints", "40", "--set", "nms_radius=7"]) == 0
    first, second = data(page)
    assert (first["name"], second["name"]) == ("a.png", "b.jpg")
    assert first["size"] == [120, 160]
    assert (first["map"]["count"], first["map"]["radius"]) == (40, 7)
    assert first["candidates"]["count"] > len(ElfRuntime().detect(photos / "a.png", max_keypoints=40, nms_radius=7))
    assert "2 images -> " in capsys.readouterr().out
    assert main([str(photos), "-r", "-o", str(page), "-q"]) == 0
    assert [image["name"] for image in data(page)] == ["a.png", "b.jpg", "sub/c.png"]
    assert capsys.readouterr().out == ""


def test_results_are_shown_with_the_settings_that_they_were_made_with(photos: Path, tmp_path: Path) -> None:
    out, page = tmp_path / "out", tmp_path / "view.html"
    assert detect(["-q", str(photos), "-o", str(out), "--max-keypoints", "30", "--nms-radius", "9"]) == 0
    assert main([str(out), "-o", str(page), "-q"]) == 0
    images = data(page)
    assert [Path(image["name"]).name for image in images] == ["a", "b"]
    assert all((image["map"]["count"], image["map"]["radius"]) == (30, 9) for image in images)


def test_images_of_a_folder_are_taken_rather_than_results_below_it(
    photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "view.html"
    assert detect(["-q", str(photos / "a.png"), "-o", str(photos / "old"), "--no-picture"]) == 0
    assert main([str(photos), "-o", str(page)]) == 0
    assert [image["name"] for image in data(page)] == ["a.png", "b.jpg"]
    assert capsys.readouterr().out.splitlines()[0] == f"{photos}: 2 images"
    assert main([str(photos / "old"), "-o", str(page)]) == 0
    assert capsys.readouterr().out.splitlines()[0] == f"{photos / 'old'}: 1 results of elf-detect"


@pytest.mark.parametrize("of_results", [False, True])
def test_what_can_not_be_read_is_left_out_and_said(
    of_results: bool, photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, folder, bad = tmp_path / "view.html", photos, photos / "aa.png"
    if of_results:
        folder = tmp_path / "out"
        assert detect(["-q", str(photos), "-o", str(folder), "--no-picture"]) == 0
        bad = folder / "aa.npz"
    bad.write_bytes(b"neither")
    capsys.readouterr()
    assert main([str(folder), "-o", str(page)]) == 1
    assert [Path(image["name"]).stem for image in data(page)] == ["a", "b"]
    captured = capsys.readouterr()
    assert captured.err.startswith(f"elf-view: error: {bad}: not a")
    *_, last, error = captured.out.splitlines()
    assert last.startswith(f"2 images -> {page}, ")
    assert last.endswith(", 1 failed:")
    assert f"elf-view: error:{error[1:]}\n" == captured.err


def test_a_mask(photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, mask = tmp_path / "view.html", np.zeros((120, 160), np.uint8)
    mask[:, :80] = 255
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    assert main([str(photos), "-o", str(page), "-q", "--mask", str(tmp_path / "mask.png")]) == 0
    for image in data(page):
        places = np.frombuffer(base64.b64decode(image["candidates"]["places"]), "<f4").reshape(-1, 2)
        assert len(places) > 10
        assert places[:, 0].max() < 80
    assert detect(["-q", str(photos / "a.png"), "-o", str(tmp_path / "out"), "--no-picture"]) == 0
    words = [str(tmp_path / "out"), "-o", str(page), "--mask", str(tmp_path / "mask.png")]
    status, line = refused(words, capsys)
    assert (status, line.endswith("leave out --mask")) == (2, True)


def test_what_can_not_be_sought_again_is_shown_as_it_is(photos: Path, tmp_path: Path) -> None:
    elf, image = ElfRuntime(), photos / "a.png"
    found = elf.detect(image)
    mask = tmp_path / "mask.png"
    cv2.imwrite(str(mask), np.full((120, 160), 255, np.uint8))
    assert detect(["-q", str(image), "-o", str(tmp_path / "masked"), "--mask", str(mask)]) == 0
    (masked,) = (tmp_path / "masked").rglob("*.npz")
    files = {
        "another model": ({**(found.record or {}), "model_sha256": "0"}, True),
        "not at hand, or another": ({**(found.record or {}), "image": str(tmp_path / "gone.png")}, False),
        "a mask": (Features.load(masked).record, True),
    }
    for why, (record, has_picture) in files.items():
        found.save(tmp_path / "one.npz", record)
        shown = of_result(elf, tmp_path / "one.npz", "one")
        assert why in shown.note
        assert shown.map is None
        assert (shown.picture is not None) == has_picture
        np.testing.assert_array_equal(shown.features.keypoints, found.keypoints)
        assert shown.features.descriptors.dtype == np.uint8


def test_of_oriented_keypoints_only_those_found_are_described(photos: Path, tmp_path: Path) -> None:
    page = tmp_path / "view.html"
    assert main([str(photos), "-o", str(page), "-q", "--set", "oriented=true"]) == 0
    first, _ = data(page)
    assert first["candidates"]["count"] == len(ElfRuntime().detect(photos / "a.png", oriented=True))
    assert first["map"] is not None
    assert "oriented" in first["note"]


@pytest.mark.parametrize("settings", [["--preset", "multiscale"], ["--grid", "2x3"]])
def test_scales_and_grids_are_shown_as_they_were_detected(photos: Path, tmp_path: Path, settings: list[str]) -> None:
    page = tmp_path / "view.html"
    assert main([str(photos), "-o", str(page), "-q", *settings]) == 0
    for image in data(page):
        assert image["map"] is None
        assert "only level and count" in image["note"]


def test_features_without_a_record_or_of_sift_are_shown(tmp_path: Path) -> None:
    rows = np.full((3, 128), 20.0, np.float32)
    Features(np.full((3, 2), 9.0, np.float32), np.ones(3, np.float32), rows, (40, 50)).save(tmp_path / "sift.npz")
    assert main([str(tmp_path), "-o", str(tmp_path / "view.html"), "-q"]) == 0
    (image,) = data(tmp_path / "view.html")
    assert (image["picture"], image["candidates"]["count"], image["candidates"]["dim"]) == (None, 3, 0)


def test_the_page_is_opened_where_that_is_asked_for(
    photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda url: bool(opened.append(url)) or len(opened) == 1)
    words = [str(photos), "-o", str(tmp_path / "a page.html"), "-q", "--open"]
    assert main(words) == 0
    assert opened == [(tmp_path / "a page.html").as_uri()]
    assert main(words) == 1
    assert "no browser could be started" in capsys.readouterr().err


def refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    status = main(words)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    return status, lines[0]


def test_refusals_are_one_line_each(photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, empty = str(tmp_path / "view.html"), tmp_path / "empty"
    empty.mkdir()
    notes = tmp_path / "notes.html"
    notes.write_text("mine")
    cases = [
        ([str(tmp_path / "none")], 1, "there is no such folder"),
        ([str(photos / "a.png")], 1, "not a folder"),
        ([str(empty)], 2, "no images .* and no results of elf-detect"),
        ([str(photos), "-o", str(tmp_path / "view.png")], 2, "the page is an .html file"),
        ([str(photos), "-o", str(notes)], 2, "no page of elf-view"),
        ([str(photos), "-o", str(notes / "view.html")], 1, "is not a folder"),
        ([str(photos), "--set", "speed=1"], 2, "unknown setting"),
    ]
    for words, status, text in cases:
        found = refused([*words[:1], "-o", page, *words[1:]], capsys)
        assert found[0] == status, words
        assert re.search(text, found[1]), (words, found[1])
    assert notes.read_text() == "mine"
    assert not Path(page).exists()


def test_settings_are_not_for_results(photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert detect(["-q", str(photos), "-o", str(tmp_path / "out")]) == 0
    words = [str(tmp_path / "out"), "-o", str(tmp_path / "view.html"), "--preset", "fast"]
    assert refused(words, capsys) == (
        2,
        f"elf-view: error: {tmp_path / 'out'} has results, whose settings are those that they were made with: "
        "leave out preset",
    )


def test_a_page_is_whole_or_as_it_was(photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "view.html"
    assert main([str(photos), "-o", str(page), "-q"]) == 0
    before = page.read_bytes()
    for path in (photos / "a.png", photos / "b.jpg"):
        path.write_text("no image")
    assert main([str(photos), "-o", str(page), "-q"]) == 1
    *errors, last = capsys.readouterr().err.splitlines()
    assert [Path(line.split(": ")[2]).name for line in errors] == ["a.png", "b.jpg"]
    assert last == f"elf-view: error: {photos}: none of its files can be shown, so no page is written"
    assert page.read_bytes() == before
    assert is_page(page)
    assert not list(tmp_path.glob(".*"))


def test_maps_are_stored_so_that_whole_levels_are_exact() -> None:
    for top in (0.0, 1.0, 254.9, 255.0, 387.4, 70000.0):
        step = quantization_step(top)
        assert top / step <= 65535
        assert np.log2(step) == round(np.log2(step))
        assert top <= 1 or (116 / step).is_integer() or step > 1


def test_pictures_have_1600_pixels_at_most_and_all_bits_are_seen() -> None:
    large = np.tile(np.linspace(0, 4095, 3200).astype(np.uint16), (100, 1))
    shown = small(large)
    assert shown.shape == (50, 1600, 3)
    assert shown.max() >= 254
