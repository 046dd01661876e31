"""Masks and alpha channels: no keypoints where there is no image, nor where the network sees the edge of it."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from elf_runtime import DetectionParams, ElfRuntime, ImageError, SettingError
from elf_runtime.commands import detect as detect_command
from elf_runtime.detection.threshold import blurred, passing
from elf_runtime.image import read
from elf_runtime.image.masks import shrunk
from helpers import ROOT, textured


@pytest.fixture(scope="module")
def elf() -> ElfRuntime:
    return ElfRuntime(threads=1)


@pytest.fixture(scope="module")
def scene() -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """A photograph that lies askew on black ground, and what of the frame it covers."""
    photo = cv2.imread(str(ROOT / "demo" / "palace.jpg"))
    height, width = photo.shape[:2]
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), 25, 0.8)
    whole = np.full((height, width), 255, np.uint8)
    return (
        np.asarray(cv2.warpAffine(photo, turn, (width, height)), np.uint8),
        np.asarray(cv2.warpAffine(whole, turn, (width, height), flags=cv2.INTER_NEAREST), np.uint8),
    )


def distance_to_edge(mask: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How many pixels, along x or y whichever is more, each point is away from what the mask leaves out."""
    x, y = np.rint(points).astype(int).T
    framed = np.pad(mask, 200, mode="edge")
    return np.asarray(cv2.distanceTransform(framed, cv2.DIST_C, 3)[y + 200, x + 200])


@pytest.mark.parametrize(("preset", "least"), [("fast", 20), ("default", 15), ("accurate", 10)])
def test_keypoints_keep_away_from_a_mask_s_edge(
    elf: ElfRuntime, scene: tuple[np.ndarray, np.ndarray], preset: str, least: int
) -> None:
    """Half of relu2_1's field of 10 pixels and half the blur's window, at the working scale."""
    picture, mask = scene
    found = elf.detect(picture, preset=preset, mask=mask)
    assert len(found) > 300
    assert distance_to_edge(mask, found.keypoints).min() > least
    near = elf.detect(picture, preset=preset, mask=mask, mask_border=0)
    assert distance_to_edge(mask, near.keypoints).min() <= 3
    some = elf.detect(picture, preset=preset, mask=mask, mask_border=40)
    assert distance_to_edge(mask, some.keypoints).min() > 40


def test_alpha_is_a_mask_as_array_and_as_file(
    elf: ElfRuntime, scene: tuple[np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    picture, mask = scene
    wanted = elf.detect(picture, mask=mask).keypoints
    with_alpha = np.dstack([picture, mask])
    np.testing.assert_array_equal(elf.detect(with_alpha).keypoints, wanted)
    np.testing.assert_array_equal(elf.detect_batch([with_alpha, picture], masks=[None, mask])[0].keypoints, wanted)
    cv2.imwrite(str(tmp_path / "a.png"), with_alpha)
    np.testing.assert_array_equal(elf.detect(tmp_path / "a.png").keypoints, wanted)
    # These writers put other colours where nothing is to be seen.
    for name, options in (("a.tiff", []), ("a.webp", [cv2.IMWRITE_WEBP_QUALITY, 101])):
        cv2.imwrite(str(tmp_path / name), with_alpha, options)
        found = elf.detect(tmp_path / name)
        assert len(found) == len(wanted)
        assert distance_to_edge(mask, found.keypoints).min() > 14
    deep = with_alpha.astype(np.uint16) * np.uint16(257)
    cv2.imwrite(str(tmp_path / "deep.png"), deep)
    assert read(tmp_path / "deep.png").shape == deep.shape
    assert distance_to_edge(mask, elf.detect(tmp_path / "deep.png").keypoints).min() > 14


def test_mask_and_alpha_together(elf: ElfRuntime, scene: tuple[np.ndarray, np.ndarray]) -> None:
    picture, mask = scene
    left = np.zeros(mask.shape, np.uint8)
    left[:, :300] = 1
    both = elf.detect(np.dstack([picture, mask]), mask=left).keypoints
    np.testing.assert_array_equal(both, elf.detect(picture, mask=(mask > 0) & (left > 0)).keypoints)


def test_only_alpha_of_zero_is_no_image(elf: ElfRuntime) -> None:
    image = textured(160, 200)
    faint = np.dstack([image, np.full((160, 200), 1, np.uint8)])
    np.testing.assert_array_equal(elf.detect(faint).keypoints, elf.detect(image).keypoints)
    assert len(elf.detect(np.dstack([image, np.zeros((160, 200), np.uint8)]))) == 0


def test_a_mask_file_with_alpha(scene: tuple[np.ndarray, np.ndarray], tmp_path: Path) -> None:
    """White where it counts, and cut out: what is cut out does not count."""
    picture, mask = scene
    cv2.imwrite(str(tmp_path / "photo.png"), picture)
    cv2.imwrite(str(tmp_path / "mask.png"), np.dstack([np.full_like(picture, 255), mask]))
    command = ["--mask", str(tmp_path / "mask.png"), "--no-picture", "-o", str(tmp_path / "out")]
    assert detect_command.main([str(tmp_path / "photo.png"), *command]) == 0
    found = np.load(next((tmp_path / "out").rglob("photo*.npz")))["keypoints"]
    assert len(found) > 300
    assert distance_to_edge(mask, found).min() > 14


@pytest.mark.parametrize("settings", [{}, {"normalize": 0.95}, {"quantize": True}])
def test_what_is_no_image_does_not_set_the_level(settings: dict[str, float]) -> None:
    """The edge of a bright surround is stronger than anything in the picture."""
    params = DetectionParams(**settings)  # type: ignore[arg-type]
    saliency = textured(80, 120)[:, :, 0].astype(np.float32)
    surround, allowed = saliency.copy(), np.ones((80, 120), np.bool_)
    allowed[:, 60:] = False
    surround[:, 70:] *= 50
    alone = np.ascontiguousarray(surround[:, :70])
    found = passing(*blurred(surround, params, allowed), params, allowed)
    wanted = passing(*blurred(alone, params, allowed[:, :70].copy()), params, allowed[:, :70].copy())
    assert 0.02 < wanted.mean() < 0.9
    np.testing.assert_array_equal(found[:, :70], wanted)
    assert not found[:, 60:].any()


@pytest.mark.parametrize("orientation", range(1, 9))
def test_alpha_turns_with_the_picture(tmp_path: Path, orientation: int) -> None:
    """A PNG may carry an orientation too; OpenCV obeys it for the colours only."""
    image = np.dstack([textured(40, 60), textured(40, 60, 1)[:, :, 0]])
    data = cv2.imencode(".png", image)[1].tobytes()
    exif = b"MM\0*\0\0\0\x08\0\1\x01\x12\0\3\0\0\0\1" + bytes([0, orientation, 0, 0]) + bytes(4)
    chunk = len(exif).to_bytes(4, "big") + b"eXIf" + exif + zlib.crc32(b"eXIf" + exif).to_bytes(4, "big")
    (tmp_path / "turned.png").write_bytes(data[:33] + chunk + data[33:])
    found = read(tmp_path / "turned.png")
    colours = cv2.imread(str(tmp_path / "turned.png"))
    np.testing.assert_array_equal(found[:, :, :3], colours)
    turns = {tuple(row) for row in np.dstack([found]).reshape(-1, 4).tolist()}
    assert turns == {tuple(row) for row in image.reshape(-1, 4).tolist()}  # each pixel kept its own alpha


@pytest.mark.parametrize("shape", ["grey", "grey, one channel", "colour", "alpha"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_flat_margin_is_no_blank_image(elf: ElfRuntime, shape: str, dtype: type) -> None:
    """Scans, letterboxed and undistorted pictures have columns and rows of one value."""
    image = textured(160, 200)
    for flat in (np.s_[:, :30], np.s_[:30], np.s_[:, 170:], np.s_[130:]):
        picture = image.copy()
        picture[flat] = 0
        given = {"grey": picture[:, :, 0], "grey, one channel": picture[:, :, :1], "colour": picture}.get(
            shape, np.dstack([picture, np.full((160, 200), 255, np.uint8)])
        )
        given = given.astype(dtype) * dtype(1 if dtype is np.uint8 else 257)
        assert len(elf.detect(given)) > 20
        assert elf.saliency(given).max() > 0
    assert len(elf.detect(np.zeros_like(given))) == 0


def png(width: int, height: int, *chunks: tuple[bytes, bytes]) -> bytes:
    """A grey or coloured PNG from its chunks behind the header's."""
    parts = [b"\x89PNG\r\n\x1a\n"]
    for kind, data in chunks:
        parts.append(len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big"))
    return b"".join(parts)


@pytest.mark.parametrize("before", [b"", b"IDAT in a comment", bytes(100_000)], ids=["none", "word", "long"])
@pytest.mark.parametrize(("depth", "color"), [(8, 0), (16, 0), (4, 0), (8, 2), (8, 3)])
def test_a_png_may_name_a_colour_that_is_no_image(tmp_path: Path, before: bytes, depth: int, color: int) -> None:
    rng = np.random.default_rng(0)
    values = rng.integers(0, 1 << depth, (40, 60))
    values[:, :20] = 3  # what is transparent
    if color == 0:
        pixels = values.astype(">u2").view(np.uint8).reshape(40, 120) if depth == 16 else values.astype(np.uint8)
        pixels = pixels[:, ::2] << 4 | pixels[:, 1::2] if depth == 4 else pixels
        special = (3).to_bytes(2, "big")
    elif color == 2:
        pixels = np.repeat(values.astype(np.uint8), 3, axis=1)
        special = (3).to_bytes(2, "big") * 3
    else:
        pixels, special = values.astype(np.uint8), bytes([255, 255, 255, 0])
    raw = b"".join(b"\0" + row.tobytes() for row in pixels)
    palette = [(b"PLTE", bytes(range(256)) * 3)] if color == 3 else []
    header = struct.pack(">IIBBBBB", 60, 40, depth, color, 0, 0, 0)
    data = png(60, 40, (b"IHDR", header), (b"tEXt", b"Comment\0" + before), *palette, (b"tRNS", special),
               (b"IDAT", zlib.compress(raw)), (b"IEND", b""))  # fmt: skip
    (tmp_path / "a.png").write_bytes(data)
    found = read(tmp_path / "a.png")
    assert found.shape == (40, 60, 4)
    np.testing.assert_array_equal(found[:, :, 3] == 0, values == 3)
    assert found.dtype == (np.uint16 if depth == 16 else np.uint8)


@pytest.mark.parametrize("extra", [0, 1, 2, None])
@pytest.mark.parametrize("order", ["<", ">"])
def test_a_tiff_s_fourth_channel_is_alpha_only_if_it_says_so(tmp_path: Path, extra: int | None, order: str) -> None:
    pixels = textured(40, 60, channels=4)
    pixels[:, :20, 3] = 0
    tags = [(256, 4, 1, 60), (257, 4, 1, 40), (258, 3, 4, 200), (259, 3, 1, 1), (262, 3, 1, 2), (273, 4, 1, 300),
            (277, 3, 1, 4), (278, 4, 1, 40), (279, 4, 1, pixels.size)]  # fmt: skip
    tags += [(338, 3, 1, extra)] if extra is not None else []
    rows = b"".join(
        struct.pack(f"{order}HHI", tag, kind, count)
        + (struct.pack(f"{order}HH", value, 0) if kind == 3 and count == 1 else struct.pack(f"{order}I", value))
        for tag, kind, count, value in tags
    )
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}IH", 8, len(tags)) + rows + bytes(4)
    data = head.ljust(200, b"\0") + struct.pack(f"{order}4H", 8, 8, 8, 8)
    (tmp_path / "a.tiff").write_bytes(data.ljust(300, b"\0") + pixels.tobytes())
    found = read(tmp_path / "a.tiff")
    assert found.shape == (40, 60, 3 if extra == 0 else 4)
    if extra != 0:
        np.testing.assert_array_equal(found[:, :, 3], pixels[:, :, 3])


def test_alpha_that_opencv_does_not_decode_is_no_secret(tmp_path: Path) -> None:
    """A grey TIFF with alpha."""
    pixels = textured(40, 60, channels=2)
    tags = [(256, 4, 60), (257, 4, 40), (258, 3, 8), (259, 3, 1), (262, 3, 1), (273, 4, 300), (277, 3, 2), (278, 4, 40),
            (279, 4, pixels.size), (338, 3, 2)]  # fmt: skip
    rows = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in tags)
    head = b"II*\0" + struct.pack("<IH", 8, len(tags)) + rows + bytes(4)
    (tmp_path / "a.tiff").write_bytes(head.ljust(300, b"\0") + pixels.tobytes())
    if cv2.imread(str(tmp_path / "a.tiff"), cv2.IMREAD_UNCHANGED) is not None:
        with pytest.raises(ImageError, match=r"a\.tiff: the TIFF file has an alpha channel that OpenCV does not"):
            read(tmp_path / "a.tiff")


@pytest.mark.parametrize("pixels", [0, 1, 5, 100])
def test_shrinking_is_a_plain_loop_s(pixels: int) -> None:
    rng = np.random.default_rng(pixels)
    mask = rng.random((30, 41)) > 0.01
    wanted = mask.copy()
    for y, x in np.argwhere(~mask):
        wanted[max(0, y - pixels) : y + pixels + 1, max(0, x - pixels) : x + pixels + 1] = False
    np.testing.assert_array_equal(shrunk(mask, pixels), wanted)


@pytest.mark.parametrize("value", ["wide", -1, 2.5, None, True, np.zeros(2)])
def test_a_mask_border_is_auto_or_pixels(elf: ElfRuntime, value: object) -> None:
    if value is None:
        assert elf.params(mask_border=None).mask_border == "auto"
        return
    with pytest.raises(SettingError, match="mask_border is 'auto' or an integer >= 0"):
        elf.params(mask_border=value)


@pytest.mark.parametrize("bits", [8, 16])
def test_planar_tiffs_and_pams_with_alpha_are_not_misread(tmp_path: Path, bits: int) -> None:
    """OpenCV decodes some of them to other pixels."""
    pixels = textured(40, 60).astype(np.uint8 if bits == 8 else np.uint16)
    size = pixels[:, :, 0].nbytes
    tags = [(256, 4, 1, 60), (257, 4, 1, 40), (258, 3, 3, 200), (259, 3, 1, 1), (262, 3, 1, 2), (273, 4, 3, 220),
            (277, 3, 1, 3), (278, 4, 1, 40), (279, 4, 3, 240), (284, 3, 1, 2)]  # fmt: skip
    rows = b"".join(struct.pack("<HHII", *tag) for tag in tags)
    head = (b"II*\0" + struct.pack("<IH", 8, len(tags)) + rows + bytes(4)).ljust(200, b"\0")
    head = (head + struct.pack("<3H", bits, bits, bits)).ljust(220, b"\0")
    head += struct.pack("<3I", *(300 + size * i for i in range(3))).ljust(20, b"\0") + struct.pack("<3I", *[size] * 3)
    planes = b"".join(pixels[:, :, c].tobytes() for c in (2, 1, 0))  # red first
    (tmp_path / "planar.tiff").write_bytes(head.ljust(300, b"\0") + planes)
    if bits == 8:
        np.testing.assert_array_equal(read(tmp_path / "planar.tiff"), pixels)
    else:
        with pytest.raises(ImageError, match="it is a planar TIFF of 16 bits, which OpenCV misreads; convert it"):
            read(tmp_path / "planar.tiff")
    for depth in (2, 4):
        data = f"P7\nWIDTH 60\nHEIGHT 40\nDEPTH {depth}\nMAXVAL 255\nENDHDR\n".encode() + bytes(60 * 40 * depth)
        (tmp_path / "a.pam").write_bytes(data)
        with pytest.raises(ImageError, match="it is a PAM picture with alpha, which OpenCV misreads"):
            read(tmp_path / "a.pam")


def test_alpha_that_is_no_number(elf: ElfRuntime) -> None:
    image = np.dstack([textured(64, 80) / 255.0, np.full((64, 80), np.nan)])
    with pytest.raises(ImageError, match="alpha has NaN or infinite values"):
        elf.detect(image)
