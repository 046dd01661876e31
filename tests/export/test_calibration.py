"""Images to calibrate with: those of a folder, those that come along, and what is refused."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_export import ExportError
from elf_export.calibration import BUNDLED, MOST_IMAGES, MOST_PIXELS, calibration_set
from elf_runtime import InputSpec
from helpers import textured

FREE = InputSpec()


def write(folder: Path, name: str, height: int, width: int, seed: int = 0) -> np.ndarray:
    image = textured(height, width, seed)
    assert cv2.imwrite(str(folder / name), image)
    return image


def test_the_photographs_are_those_of_their_page() -> None:
    page = (BUNDLED / "README.md").read_text()
    listed = dict(re.findall(r"^\| (\S+\.jpg) \| \S+ \| .* \| ([0-9a-f]{64}) \|$", page.split("## Originals")[0], re.M))
    found = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in BUNDLED.glob("*.jpg")}
    assert listed == found
    assert len(found) == 12
    assert sum(path.stat().st_size for path in BUNDLED.iterdir()) < 300_000


def test_the_photographs_are_taken_as_they_are() -> None:
    images = calibration_set()
    assert len(images) == 12
    batches = list(images.batches(FREE, scale=0.5))
    for path, batch in zip(images.files, batches, strict=True):
        np.testing.assert_array_equal(batch[0], cv2.imread(str(path)).astype(np.float32))


def test_a_folder_s_images_come_in_the_order_of_their_names_at_the_working_scale(tmp_path: Path) -> None:
    second, first = write(tmp_path, "b.png", 120, 160, 1), write(tmp_path, "a.PNG", 96, 128, 2)
    (tmp_path / "notes.txt").write_text("no image")
    (tmp_path / "folder.png").mkdir()
    images = calibration_set(tmp_path)
    assert [path.name for path in images.files] == ["a.PNG", "b.png"]
    for batch, image in zip(images.batches(FREE, scale=0.5), (first, second), strict=True):
        h, w = image.shape[:2]
        # Half of each side by area: the mean of four.
        halved = image.astype(np.float64).reshape(h // 2, 2, w // 2, 2, 3).mean(axis=(1, 3))
        assert batch.dtype == np.float32
        np.testing.assert_allclose(batch[0], halved, atol=1e-4)


def test_of_a_large_image_the_middle_is_taken_at_its_own_scale(tmp_path: Path) -> None:
    image = write(tmp_path, "large.png", 900, 1200)
    (batch,) = calibration_set(tmp_path).batches(FREE)
    _, h, w, _ = batch.shape
    assert 0.98 * MOST_PIXELS < h * w <= MOST_PIXELS
    assert w / h == pytest.approx(4 / 3, rel=0.01)
    top, left = (900 - h) // 2, (1200 - w) // 2
    np.testing.assert_array_equal(batch[0], image[top : top + h, left : left + w])


def test_what_is_cut_is_what_exceeds_at_the_working_scale(tmp_path: Path) -> None:
    """At half the scale four times the pixels fit; where a graph has one size, all is taken."""
    image = write(tmp_path, "a.png", 960, 1280)
    assert MOST_PIXELS == 480 * 640
    images = calibration_set(tmp_path)
    for spec, scale, size in ((FREE, 0.5, (640, 480)), (InputSpec(height=48, width=64), 1.0, (64, 48))):
        (batch,) = images.batches(spec, scale)
        whole = cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        np.testing.assert_allclose(batch[0], whole, atol=1e-3)
    (full,) = images.batches(FREE, 1.0)
    np.testing.assert_array_equal(full[0], image[240:720, 320:960])


def test_images_are_made_what_the_graph_takes(tmp_path: Path) -> None:
    write(tmp_path, "a.png", 40, 60)
    images = calibration_set(tmp_path)
    (gray,) = images.batches(InputSpec(color="gray", channels=1), scale=0.25)
    assert gray.shape == (1, 32, 48, 1)  # not below the smallest size
    (fixed,) = images.batches(InputSpec(height=64, width=80), scale=0.5)
    assert fixed.shape == (1, 64, 80, 3)


def test_the_digest_is_of_the_contents(tmp_path: Path) -> None:
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        write(tmp_path / folder, "a.png", 40, 60)
    one, two = calibration_set(tmp_path / "one"), calibration_set(tmp_path / "two")
    assert one.sha256 == two.sha256
    write(tmp_path / "two", "a.png", 40, 60, seed=1)
    assert calibration_set(tmp_path / "two").sha256 != one.sha256
    assert calibration_set().sha256 == calibration_set().sha256 != one.sha256


@pytest.mark.parametrize("count", [MOST_IMAGES, MOST_IMAGES + 1, MOST_IMAGES * 3 // 2, MOST_IMAGES * 2])
def test_of_very_many_images_some_are_taken(tmp_path: Path, count: int) -> None:
    data = cv2.imencode(".png", textured(8, 8))[1].tobytes()
    for index in range(count):
        (tmp_path / f"{index:03d}.png").write_bytes(data)
    names = [path.name for path in calibration_set(tmp_path).files]
    places = np.linspace(0, count, MOST_IMAGES, endpoint=False)
    assert names == [f"{int(place + 1e-9):03d}.png" for place in places]


def test_the_digest_is_over_the_digests_of_all_files_whatever_they_are_called(tmp_path: Path) -> None:
    for name, seed in (("a.png", 1), ("b.png", 2)):
        write(tmp_path, name, 40, 60, seed)
    digests = [hashlib.sha256((tmp_path / name).read_bytes()).digest() for name in ("a.png", "b.png")]
    assert calibration_set(tmp_path).sha256 == hashlib.sha256(b"".join(digests)).hexdigest()
    (tmp_path / "a.png").rename(tmp_path / "aa.png")
    assert calibration_set(tmp_path).sha256 == hashlib.sha256(b"".join(digests)).hexdigest()


def test_a_set_is_called_after_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "photos").mkdir()
    write(tmp_path / "photos", "a.png", 40, 60)
    monkeypatch.chdir(tmp_path / "photos")
    assert calibration_set(".").name == calibration_set(tmp_path / "photos").name == "1 images of photos"
    assert calibration_set().name == "the exporter's photographs"


@pytest.mark.parametrize("size", [(1, 400_000), (400_000, 1)])
def test_of_a_single_row_or_column_the_middle_is_left(tmp_path: Path, size: tuple[int, int]) -> None:
    assert cv2.imwrite(str(tmp_path / "line.png"), np.arange(400_000, dtype=np.uint32).astype(np.uint8).reshape(size))
    (batch,) = calibration_set(tmp_path).batches(InputSpec(min_size=1))
    length = int(400_000 * (MOST_PIXELS / 400_000) ** 0.5)
    assert sorted(batch.shape[1:3]) == [1, length]
    wanted = (np.arange(length) + (400_000 - length) // 2) % 256
    np.testing.assert_array_equal(batch.reshape(length, 3), wanted[:, None].repeat(3, 1))


def test_every_file_is_decoded_at_once(tmp_path: Path) -> None:
    write(tmp_path, "a.png", 40, 60)
    for name, pixels, message in (
        ("b.tif", np.full((40, 60), 2, np.float32), r"b\.tif: float images are in \[0, 1\], this one is in \[2, 2\]"),
        ("c.tif", np.zeros((40, 60), np.int16), r"c\.tif: an image is uint8, uint16 or float in \[0, 1\], not int16"),
    ):
        assert cv2.imwrite(str(tmp_path / name), pixels)
        with pytest.raises(ExportError, match=message):
            calibration_set(tmp_path)
        (tmp_path / name).unlink()
    (tmp_path / "d.jpg").write_bytes(b"no image")
    with pytest.raises(ExportError, match=r"d\.jpg: not an image that OpenCV can decode"):
        calibration_set(tmp_path)


def test_flat_images_alone_are_refused(tmp_path: Path) -> None:
    for index, color in enumerate((0, 128)):
        cv2.imwrite(str(tmp_path / f"{index}.png"), np.full((40, 60, 3), color, np.uint8))
    with pytest.raises(ExportError, match=f"{tmp_path}: each image is of one colour throughout"):
        calibration_set(tmp_path)
    write(tmp_path, "2.png", 40, 60)
    assert len(calibration_set(tmp_path)) == 3


def test_what_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"nowhere: not a folder of calibration images: No such file"):
        calibration_set(tmp_path / "nowhere")
    (tmp_path / "notes.txt").write_text("no image")
    with pytest.raises(ExportError, match=r"notes\.txt: not a folder of calibration images: Not a directory"):
        calibration_set(tmp_path / "notes.txt")
    with pytest.raises(ExportError, match=r"no image to calibrate with; files that end in \.bmp"):
        calibration_set(tmp_path)
    (tmp_path / "broken.jpg").write_bytes(b"no image either")
    with pytest.raises(ExportError, match=r"broken\.jpg: not an image that OpenCV can decode"):
        list(calibration_set(tmp_path).batches(FREE))
    (tmp_path / "broken.jpg").unlink()
    assert cv2.imwrite(str(tmp_path / "a.tif"), np.full((40, 60, 3), 300.0, np.float32))
    with pytest.raises(ExportError, match=r"a\.tif: float images are in \[0, 1\]"):
        list(calibration_set(tmp_path).batches(FREE))


def test_a_refusal_names_the_file_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert cv2.imwrite(str(tmp_path / "broken.jpg"), textured(40, 60, 0))
    images, whole = calibration_set(tmp_path), (tmp_path / "broken.jpg").read_bytes()
    (tmp_path / "broken.jpg").write_bytes(b"no image")
    for look in (lambda: list(images.batches(FREE)), lambda: calibration_set(tmp_path)):
        with pytest.raises(ExportError) as caught:
            look()
        assert str(caught.value).count("broken.jpg") == 1
    (tmp_path / "broken.jpg").write_bytes(whole)

    def refuse(path: Path) -> bytes:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "read_bytes", refuse)
    with pytest.raises(ExportError) as caught:
        calibration_set(tmp_path)
    assert str(caught.value) == f"{tmp_path / 'broken.jpg'}: Permission denied"
