"""Every kind of image that a user may have, and the ones that are refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime import ImageError, InputSpec
from elf_runtime.image import read
from elf_runtime.image.convert import is_flat, resized, to_pixels
from elf_runtime.image.masks import to_mask
from helpers import textured, turned_jpeg

BGR = InputSpec()


def test_all_depths_give_the_same_pixels() -> None:
    image = textured(20, 30)
    wanted = image.astype(np.float32)
    assert np.array_equal(to_pixels(image, BGR), wanted)
    assert np.allclose(to_pixels(image.astype(np.uint16) * 257, BGR), wanted, atol=1e-4)
    for kind in (np.float32, np.float64, np.float16):
        assert np.allclose(to_pixels((image / 255).astype(kind), BGR), wanted, atol=0.1 if kind is np.float16 else 1e-4)


def test_sixteen_bits_keep_their_precision() -> None:
    image = np.arange(3000, 3000 + 32 * 32, dtype=np.uint16).reshape(32, 32)
    assert len(np.unique(to_pixels(image, BGR))) == 32 * 32


def test_grey_alpha_and_colour_order() -> None:
    image = textured(20, 30)
    grey = image[:, :, 0]
    assert np.array_equal(to_pixels(grey, BGR), np.repeat(grey[:, :, None], 3, 2).astype(np.float32))
    assert np.array_equal(to_pixels(grey[:, :, None], BGR), to_pixels(grey, BGR))
    alpha = np.dstack([image, np.full(grey.shape, 9, np.uint8)])
    assert np.array_equal(to_pixels(alpha, BGR), to_pixels(image, BGR))
    rgb = InputSpec(color="rgb")
    assert np.array_equal(to_pixels(image, rgb), image[:, :, ::-1].astype(np.float32))
    assert to_pixels(image, InputSpec(color="gray", channels=1)).shape == (20, 30, 1)
    assert to_pixels(image, InputSpec(value_range=1.0)).max() <= 1.0


def test_the_caller_s_pixels_stay_as_they_are() -> None:
    image = (textured(20, 30) / 255).astype(np.float32)
    before = image.copy()
    to_pixels(image, BGR)
    np.testing.assert_array_equal(image, before)


def test_views_and_strides_are_fine() -> None:
    image = textured(40, 60)
    assert np.array_equal(to_pixels(image[::2, ::-2], BGR), image[::2, ::-2].astype(np.float32))


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((4, 4, 3), np.int32), "not int32"),
        (np.zeros((4, 4, 3), np.complex64), "not complex64"),
        (np.zeros((4, 4, 3), object), "not object"),
        (np.zeros((4, 4, 2), np.uint8), "shape"),
        (np.zeros((2, 4, 4, 3), np.uint8), "shape"),
        (np.zeros(4, np.uint8), "shape"),
        (np.zeros((0, 4, 3), np.uint8), "empty"),
        (np.full((4, 4), np.nan, np.float32), "NaN"),
        (np.full((4, 4), np.inf, np.float32), "NaN or infinite"),
        (np.full((4, 4), 7.0, np.float32), "in \\[0, 1\\]"),
        (np.full((4, 4), -0.1, np.float32), "in \\[0, 1\\]"),
    ],
)
def test_refused(image: np.ndarray, message: str) -> None:
    with pytest.raises(ImageError, match=message):
        to_pixels(image, BGR)


def test_one_nan_among_many_is_found() -> None:
    image = np.random.default_rng(0).random((64, 64, 3)).astype(np.float32)
    image[40, 11, 2] = np.nan
    with pytest.raises(ImageError, match="NaN"):
        to_pixels(image, BGR)


def test_files(tmp_path: Path) -> None:
    image = textured(20, 30)
    cv2.imwrite(str(tmp_path / "a.png"), image)
    assert np.array_equal(read(tmp_path / "a.png"), image)
    deep = (image.astype(np.uint16) * 257)[:, :, 0]
    cv2.imwrite(str(tmp_path / "b.png"), deep)
    assert np.array_equal(read(str(tmp_path / "b.png")), deep)
    (tmp_path / "c.png").write_text("no picture")
    (tmp_path / "d.png").write_bytes(b"")
    for name in ("c.png", "d.png"):
        with pytest.raises(ImageError, match="not an image"):
            read(tmp_path / name)
    with pytest.raises(ImageError, match="No such file"):
        read(tmp_path / "missing.png")
    with pytest.raises(ImageError, match="array or a path"):
        read(3)  # type: ignore[arg-type]


def test_a_file_is_turned_as_its_exif_says_unless_that_is_ignored(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    path.write_bytes(turned_jpeg(textured(20, 30)))
    stored = read(path, ignore_exif=True)
    assert stored.shape == (20, 30, 3)
    np.testing.assert_array_equal(read(path), np.rot90(stored, -1))
    np.testing.assert_array_equal(read(path), cv2.imread(str(path)))


def test_working_size() -> None:
    pixels = to_pixels(textured(41, 61), BGR)
    assert resized(pixels, (41, 61)) is pixels
    assert resized(pixels, (20, 30)).shape == (20, 30, 3)
    assert resized(pixels, (82, 122)).shape == (82, 122, 3)
    assert resized(pixels[:, :, :1], (20, 30)).shape == (20, 30, 1)


def test_flatness() -> None:
    for color in (9, (200, 100, 50), (0, 255, 0)):
        flat = np.full((32, 32, 3), color, np.float32)
        assert is_flat(flat)
        for place in ((31, 31, 2), (0, 5, 0)):
            spot = flat.copy()
            spot[place] += 1
            assert not is_flat(spot)


def test_masks() -> None:
    mask = np.zeros((40, 60), np.uint8)
    mask[10:20, 10:20] = 255
    assert to_mask(mask, (40, 60)).sum() == 100
    assert np.array_equal(to_mask(mask[:, :, None] > 0, (40, 60)), mask > 0)
    with pytest.raises(ImageError, match=r"mask has shape \(40, 61\)"):
        to_mask(np.zeros((40, 61), np.uint8), (40, 60))
    with pytest.raises(ImageError, match="float"):
        to_mask(np.zeros((40, 60)), (40, 60))


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_rounding_beyond_the_range_is_cut_off(kind: type) -> None:
    image = np.full((4, 4, 3), 0.5, kind)
    image[0, 0], image[1, 1] = np.nextafter(kind(1), kind(2)), -1e-7
    pixels = to_pixels(image, BGR)
    assert (pixels.min(), pixels.max()) == (0.0, 255.0)
    for value, shown in ((1.00001, r"1\.00001"), (-2e-6, r"-(2|1\.9)"), (1.0000019, r"1\.000001")):
        image[0, 0] = value
        with pytest.raises(ImageError, match=rf"this one is in \[.*{shown}"):
            to_pixels(image, BGR)


@pytest.mark.parametrize("kind", ["u2", "f4", "f8"])
def test_any_byte_order(kind: str) -> None:
    image = textured(20, 30)
    values = image.astype(np.uint16) * 257 if kind == "u2" else image / 255
    for order in "<>":
        assert np.array_equal(to_pixels(values.astype(order + kind), BGR), to_pixels(values.astype(kind), BGR))
