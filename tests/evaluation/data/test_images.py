"""From a file to the pixels that are evaluated."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scenes import WORKING, photograph

from elf_eval.coordinates import warp
from elf_eval.data.images import ImageRef
from elf_eval.errors import EvalError


def test_quarter_turns_carry_the_camera_along(tmp_path):
    pixels = photograph(1)
    cv2.imwrite(str(tmp_path / "a.png"), pixels)
    for turns in range(4):
        image = ImageRef("a", tmp_path / "a.png", quarter_turns=turns).open(None)
        x, y = warp(image.to_working, [[30.0, 50.0]])[0]
        assert np.array_equal(image.pixels[round(y), round(x)], pixels[50, 30])


def test_an_image_is_turned_before_it_is_resized(tmp_path):
    """60x20 pixels become 20x60, and those 10x120; the top left corner comes to the bottom left."""
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((20, 60, 3), np.uint8))
    image = ImageRef("a.png", tmp_path / "a.png", quarter_turns=1).open((10, 120))
    corners = np.array([[-0.5, -0.5], [59.5, -0.5], [59.5, 19.5]])
    assert warp(image.to_working, corners) == pytest.approx(np.array([[-0.5, 119.5], [-0.5, -0.5], [9.5, -0.5]]))


@pytest.mark.parametrize("exact", [True, False])
def test_only_derived_images_are_resized_bit_exactly(photo_file, exact):
    pixels = cv2.imread(str(photo_file))
    methods = (cv2.INTER_LINEAR_EXACT, cv2.INTER_LINEAR)
    wanted, other = (cv2.resize(pixels, WORKING, interpolation=m) for m in (methods if exact else methods[::-1]))
    np.testing.assert_array_equal(ImageRef("a.png", photo_file, exact=exact).open(WORKING).pixels, wanted)
    assert (other != wanted).any()


def test_a_file_that_is_no_image_is_named(tmp_path):
    (tmp_path / "a.png").write_text("not an image")
    with pytest.raises(EvalError, match=r"a\.png"):
        _ = ImageRef("a", tmp_path / "a.png").open(None).pixels
