"""Sets made from single images: rotation, scale, random homographies."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scenes import WORKING, between, photograph

from elf_eval.data import open_dataset
from elf_eval.data.views import Rotation, Zoom, warp_image
from elf_eval.errors import EvalError


def test_rotation_and_scale_sets(hpatches_folder):
    turned = open_dataset(f"rotation:{hpatches_folder}")
    assert [p.parameter for p in turned.pairs[:6]] == [0, 40, 80, 120, 160, 200]
    centre = np.array([[79.5, 59.5]])
    right = centre + np.array([10, 0])
    for pair in turned.pairs[:6]:
        truth = between(pair)
        assert truth.forward(centre) == pytest.approx(centre)
        angle = np.radians(pair.parameter)
        assert truth.forward(right) - centre == pytest.approx(10 * np.array([[np.cos(angle), np.sin(angle)]]))
    zoomed = open_dataset(f"scale:{hpatches_folder}")
    assert [p.parameter for p in zoomed.pairs[:4]] == [1.25, 1.5, 1.75, 2.0]
    assert between(zoomed.pairs[3]).forward(right) == pytest.approx(centre + np.array([20, 0]))


def turned_by_default(folder):
    return open_dataset(f"rotation:{folder}").pairs[1].second


def test_angles_and_factors_by_option(hpatches_folder):
    turned = open_dataset(f"rotation:{hpatches_folder}?angles=10,50,90,130,170,210")
    assert [p.parameter for p in turned.pairs] == 2 * [10, 50, 90, 130, 170, 210]
    assert turned.pairs[5].second.view == Rotation(210)
    assert turned.pairs[5].second.name == "i_light/1@rotation-210.png"
    zoomed = open_dataset(f"scale:{hpatches_folder}?scenes=v_turn&factors=0.5,3")
    assert [p.second.view for p in zoomed.pairs] == [Zoom(0.5), Zoom(3)]
    views = [open_dataset(f"rotation:{hpatches_folder}?angles={angle}").pairs[0].second for angle in ("40", "40.0")]
    assert views[0].digest(WORKING) == views[1].digest(WORKING) == turned_by_default(hpatches_folder).digest(WORKING)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("rotation:{}?angles=ten", "option angles=ten"),
        ("rotation:{}?angles=", "option angles="),
        ("rotation:{}?angles=10,inf", "different numbers"),
        ("rotation:{}?angles=10,10.0", "different numbers"),
        ("scale:{}?factors=0", "a factor is above 0"),
        ("scale:{}?angles=10", "unknown options"),
    ],
)
def test_angles_and_factors_that_are_none(hpatches_folder, text, words):
    with pytest.raises(EvalError, match=words):
        open_dataset(text.format(hpatches_folder))


def test_a_view_at_0_degrees_is_the_image_itself(hpatches_folder):
    pair = open_dataset(f"rotation:{hpatches_folder}").pairs[0]
    assert np.array_equal(pair.first.open(WORKING).pixels, pair.second.open(WORKING).pixels)


def test_a_synthetic_pair_maps_what_it_shows(tmp_path):
    for n in range(2):
        cv2.imwrite(str(tmp_path / f"{n}.png"), photograph(n))
    dataset = open_dataset(f"synthetic:{tmp_path}?count=3&strength=0.15")
    assert len(dataset.pairs) == 6
    assert len({p.second.name for p in dataset.pairs}) == 6
    pair = dataset.pairs[4]
    again = warp_image(pair.first.open(WORKING).pixels, between(pair).homography)
    assert np.array_equal(again, pair.second.open(WORKING).pixels)


def test_every_synthetic_view_is_another(tmp_path):
    for n in range(3):
        cv2.imwrite(str(tmp_path / f"{n}.png"), photograph(n))
    pairs = open_dataset(f"synthetic:{tmp_path}?count=4&seed=7").pairs
    assert [pair.second.view.seed for pair in pairs] == list(range(7, 19))
    for strength in (0.0, 0.5):
        with pytest.raises(EvalError, match="strength"):
            open_dataset(f"synthetic:{tmp_path}?strength={strength}")


def test_a_seed_is_no_negative_number(hpatches_folder):
    with pytest.raises(EvalError, match="seed at least 0"):
        open_dataset(f"synthetic:{hpatches_folder}?seed=-5")
