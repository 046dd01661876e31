"""Files that are no images, not whole, or too large: known before they are decoded, and said in one line."""

from __future__ import annotations

import io
import os
import socket
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime import ElfError, ElfRuntime, Features, ImageError, ModelError
from elf_runtime.commands.detect import main as detect
from elf_runtime.files.kind import description
from elf_runtime.image import read
from elf_runtime.image.header import read_header
from elf_runtime.model.onnx_file import read_onnx
from helpers import ROOT, TINY, textured, turned_jpeg

# MiB, of this process alone: getrusage's peak is its parent's too.
PEAK = """
def peak():
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) // 1024 for line in status if line.startswith("VmHWM"))
"""
reads_proc = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads peak memory from /proc")
JPEG = (ROOT / "demo" / "palace.jpg").read_bytes()


def png_of(width: int, height: int, rows: int | None = None) -> bytes:
    """A PNG of zeros, as small as it gets; valid, unless it has fewer `rows` than it says."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big")

    row = zlib.compressobj(9)
    data = b"".join(row.compress(bytes(width * 3 + 1)) for _ in range(height if rows is None else rows)) + row.flush()
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


WRITTEN = {
    "a.png": "PNG", "a.jpg": "JPEG", "a.webp": "WebP", "a.bmp": "BMP", "a.tiff": "TIFF", "a.ppm": "PNM", "a.pgm": "PNM",
    "a.pbm": "PNM", "a.jp2": "JPEG 2000", "a.hdr": "HDR", "a.ras": "Sun raster", "a.pam": "PAM", "a.pfm": "PFM",
    "a.gif": "GIF", "a.avif": "AVIF or HEIF", "a.exr": "OpenEXR",
}  # fmt: skip


@pytest.mark.parametrize(("name", "kind"), WRITTEN.items())
def test_headers_say_what_opencv_decodes(tmp_path: Path, name: str, kind: str) -> None:
    image = textured(53, 71)
    source = image.astype(np.float32) / 255 if kind in ("HDR", "PFM", "OpenEXR") else image
    try:
        written = cv2.imwrite(str(tmp_path / name), source[:, :, 0] if name in ("a.pgm", "a.pbm") else source)
    except cv2.error:
        written = False
    if not written:
        pytest.skip(f"this build of OpenCV writes no {name}")
    with (tmp_path / name).open("rb") as file:
        header = read_header(file)
    assert header is not None
    assert (header.kind, header.width, header.height) == (kind, 71, 53)
    with pytest.raises(ImageError, match=f"the {kind} file has 71x53 pixels, more than the limit of 3,762"):
        read(tmp_path / name, max_pixels=71 * 53 - 1)
    if cv2.imread(str(tmp_path / name), cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH) is not None:
        assert read(tmp_path / name, max_pixels=71 * 53).shape[:2] == (53, 71)


def test_a_jpeg_s_size_lies_behind_its_metadata() -> None:
    turned = turned_jpeg(textured(40, 60))
    padded = turned[:2] + (b"\xff\xe2\xff\xff" + bytes(65533)) * 3 + turned[2:]
    header = read_header(io.BytesIO(padded))
    assert header is not None
    assert (header.width, header.height) == (60, 40)


@reads_proc
def test_a_bomb_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    (tmp_path / "bomb.png").write_bytes(png_of(30000, 30000, rows=64))
    script = (
        f"import sys\n{PEAK}"
        "from elf_runtime.commands.detect import main\n"
        f"status = main([sys.argv[1], '-o', sys.argv[2], '--model', {str(TINY)!r}])\n"
        "print(peak())\n"
        "sys.exit(status)\n"
    )
    env = {**os.environ, "PYTHONPATH": str(ROOT / "runtime")}
    command = [sys.executable, "-c", script, str(tmp_path / "bomb.png"), str(tmp_path / "out")]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert "the PNG file has 30000x30000 pixels, more than the limit of 100,000,000; max_pixels" in done.stderr
    assert done.stderr.count("\n") == 1
    assert int(done.stdout.split()[-1]) < 400  # MiB


@reads_proc
def test_a_large_blank_file_costs_little_more_than_its_pixels(tmp_path: Path) -> None:
    (tmp_path / "blank.png").write_bytes(png_of(9000, 9000))
    script = (
        f"import sys\n{PEAK}"
        "from elf_runtime import ElfRuntime\n"
        "elf = ElfRuntime()\n"
        "before = peak()\n"
        "found = elf.detect(sys.argv[1])\n"
        "print(len(found), peak() - before)\n"
    )
    env = {**os.environ, "PYTHONPATH": str(ROOT / "runtime")}
    command = [sys.executable, "-c", script, str(tmp_path / "blank.png")]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=60, check=True)
    count, mebibytes = map(int, done.stdout.split())
    assert count == 0
    assert mebibytes < 800  # the decoder's pixels are 232, and are there twice; in floats 927 more


def test_the_limit_is_an_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), textured(64, 80))
    options = ["-o", str(tmp_path / "out"), "--model", str(TINY), "--no-picture"]
    assert detect([str(tmp_path / "a.png"), *options, "--max-pixels", "5119"]) == 1
    assert "more than the limit of 5,119" in capsys.readouterr().err
    assert detect([str(tmp_path / "a.png"), *options, "--max-pixels", "5120"]) == 0
    with pytest.raises(ImageError, match="more than the limit of 5,119"):
        ElfRuntime(TINY, max_pixels=5119).detect(tmp_path / "a.png")
    assert len(ElfRuntime(TINY, max_pixels=None).detect(tmp_path / "a.png")) > 0


NO_IMAGES = {
    b"": "it is empty",
    b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 1\n": "a git-lfs pointer",
    b"<!DOCTYPE html>\n<html><body>Not found</body></html>": "a web page",
    b"\n <HTML lang='en'>": "a web page",
    b"<?xml version='1.0'?><svg/>": "an XML document",
    b'{"message": "Not Found"}': "JSON text",
    b"rate limit exceeded": "it is text",
    bytes(1000): "zero bytes",
    b"PK\x03\x04" + bytes(100): "a zip archive",
    b"%PDF-1.7": "a PDF document",
    b"\0\0\0\x18ftypmp42": "an MP4 or QuickTime video",
}


@pytest.mark.parametrize(("data", "what"), NO_IMAGES.items(), ids=list(NO_IMAGES.values()))
def test_what_a_file_is_that_is_no_image_and_no_model(tmp_path: Path, data: bytes, what: str) -> None:
    path = tmp_path / "file.bin"
    path.write_bytes(data)
    said = what.removeprefix("it is ")
    with pytest.raises(ImageError, match=f"file.bin: not an image that OpenCV can decode: it is .*{said}"):
        read(path)
    for load in (ElfRuntime, read_onnx):
        with pytest.raises(ModelError, match=f"file.bin: .*{said}"):
            load(path)


def test_nothing_is_said_of_what_is_unknown() -> None:
    assert description(bytes(range(128, 256))) is None
    assert description(b"\x08\x08\x12\x07pytorch") is None


@pytest.mark.parametrize("share", [0.3, 0.5, 0.95, 0.999])
@pytest.mark.parametrize("ending", [".jpg", ".png", ".webp", ".bmp", ".gif"])
def test_cut_off_images(tmp_path: Path, ending: str, share: float) -> None:
    data = JPEG if ending == ".jpg" else _encoded(ending)
    (tmp_path / f"cut{ending}").write_bytes(data[: int(share * len(data))])
    with pytest.raises(ImageError, match=r"file is cut off: data are missing at its end"):
        read(tmp_path / f"cut{ending}")


def _encoded(ending: str) -> bytes:
    try:
        return cv2.imencode(ending, textured(64, 80))[1].tobytes()
    except cv2.error:
        pytest.skip(f"this build of OpenCV writes no {ending}")


def test_what_stands_behind_an_image_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(JPEG + b"MotionPhoto" + bytes(5000))
    (tmp_path / "a.png").write_bytes(cv2.imencode(".png", textured(64, 80))[1].tobytes() + b"more")
    assert read(tmp_path / "a.jpg").shape == (427, 640, 3)
    assert read(tmp_path / "a.png").shape == (64, 80, 3)


def test_a_damaged_image_is_told_from_a_cut_off_one(tmp_path: Path) -> None:
    data = bytearray(cv2.imencode(".png", textured(64, 80))[1].tobytes())
    data[16:24] = struct.pack(">II", 0, 64)
    (tmp_path / "a.png").write_bytes(data)
    with pytest.raises(ImageError, match="the PNG file is damaged"):
        read(tmp_path / "a.png")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in this file system")
@pytest.mark.parametrize("load", [read, ElfRuntime, Features.load, read_onnx])
def test_what_is_no_regular_file_is_not_waited_for(tmp_path: Path, load: object) -> None:
    assert callable(load)
    os.mkfifo(tmp_path / "pipe")
    os.symlink("loop", tmp_path / "loop")
    with socket.socket(socket.AF_UNIX) as server:
        os.chdir(tmp_path)
        server.bind("socket")
        for path, reason in (
            ("pipe", "not a file but a pipe"), ("/dev/zero", "not a file but a device"), (".", "but a folder"),
            ("loop", "Too many levels of symbolic links"), ("absent", r"[Nn]o such file"), ("socket", "but a socket"),
        ):  # fmt: skip
            with pytest.raises(ElfError, match=reason):
                load(path)
    os.chdir(ROOT)


@pytest.mark.parametrize("shape", [(32, 70000), (70000, 32)])
def test_very_long_images(shape: tuple[int, int]) -> None:
    image = np.tile(textured(32, 500)[:, :, 0], (1, 140)) if shape[0] == 32 else None
    image = image if image is not None else np.ascontiguousarray(np.tile(textured(500, 32)[:, :, 0], (140, 1)))
    assert len(ElfRuntime(TINY, threads=1).detect(image, threshold="none")) > 0
