"""HPatches' layout: what is found, and what is said when something is missing."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from scenes import SIZE, WORKING, between

from elf_eval.coordinates import warp
from elf_eval.data import open_dataset
from elf_eval.data.views import warp_image
from elf_eval.errors import EvalError


def test_hpatches_pairs_image_1_with_the_others(hpatches_folder):
    dataset = open_dataset(f"hpatches:{hpatches_folder}")
    assert [p.name for p in dataset.pairs[:2]] == [
        "i_light/1.png - i_light/2.png",
        "i_light/1.png - i_light/3.png",
    ]
    assert len(list(dataset.images())) == 6
    assert open_dataset(f"hpatches:{hpatches_folder}?part=v").scenes() == ["v_turn"]
    assert open_dataset(f"hpatches:{hpatches_folder}?scenes=i_light").scenes() == ["i_light"]


def test_homographies_follow_the_resized_images(hpatches_folder):
    pair = open_dataset(f"hpatches:{hpatches_folder}").pairs[1]
    matrix = np.reshape(pair.truth.matrix, (3, 3))
    point = np.array([[80.0, 60.0]])  # in the file's 200 x 160 pixels
    there = warp(matrix, point)
    scale = np.array([WORKING[0] / SIZE[0], WORKING[1] / SIZE[1]])
    small, small_there = (point + 0.5) * scale - 0.5, (there + 0.5) * scale - 0.5
    truth = between(pair)
    assert truth.forward(small) == pytest.approx(small_there, abs=1e-9)
    assert truth.backward(small_there) == pytest.approx(small, abs=1e-9)


def test_the_homography_leads_to_the_same_pixels(hpatches_folder):
    pair = open_dataset(f"hpatches:{hpatches_folder}").pairs[1]
    first, second = pair.first.open(WORKING).pixels, pair.second.open(WORKING).pixels
    seen = warp_image(first, between(pair).homography)
    error = np.abs(seen.astype(float) - second)[20:100, 20:140]
    assert np.median(error) < 6
    assert np.corrcoef(seen[20:100, 20:140].ravel(), second[20:100, 20:140].ravel())[0, 1] > 0.97


def test_the_eight_large_scenes_can_be_left_out(hpatches_folder, tmp_path):
    root = tmp_path / "set"
    shutil.copytree(hpatches_folder / "i_light", root / "i_light")
    shutil.copytree(hpatches_folder / "i_light", root / "i_dc")
    assert open_dataset(f"hpatches:{root}").scenes() == ["i_dc", "i_light"]
    assert open_dataset(f"hpatches:{root}?drop8=true").scenes() == ["i_light"]


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda f: (f / "H_1_3").unlink(), ["v_turn/H_1_3"]),
        (lambda f: (f / "3.png").unlink(), ["v_turn", "one image 3.*"]),
        (lambda f: (f / "H_1_2").write_text("1 0 0 0 1 0"), ["H_1_2", "3x3", "6 numbers"]),
        (lambda f: (f / "H_1_2").write_text("1 0 0 one"), ["H_1_2", "not a matrix"]),
        (lambda f: (f / "H_1_2").write_text("1 0 0 1 0 0 0 0 1"), ["H_1_2", "singular"]),
        (lambda f: shutil.copy(f / "1.png", f / "1.jpg"), ["1.jpg", "1.png"]),
    ],
)
def test_damage_is_named(hpatches_folder, tmp_path, damage, words):
    shutil.copytree(hpatches_folder, tmp_path / "set")
    damage(tmp_path / "set" / "v_turn")
    with pytest.raises(EvalError) as error:
        open_dataset(f"hpatches:{tmp_path / 'set'}")
    assert all(word in str(error.value) for word in words), error.value


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("hpatches:nowhere", "no such folder"),
        ("patches:{}", "unknown kind"),
        ("hpatches:{}?part=x", "expected i or v"),
        ("hpatches:{}?scenes=i_dark", "i_dark"),
        ("hpatches:{}?fast=true", "unknown options"),
        ("hpatches:{}?drop8=yes", "drop8=yes"),
    ],
)
def test_a_wrong_text_is_named(hpatches_folder, text, words):
    with pytest.raises(EvalError, match=words):
        open_dataset(text.format(hpatches_folder))
