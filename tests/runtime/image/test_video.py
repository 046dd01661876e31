"""Frames of video files: which, in which order, and what is no video."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime import ImageError
from elf_runtime.image.video import Video
from runtime.clips import LEVELS, clip


@pytest.mark.parametrize(
    ("every", "limit", "numbers"),
    [(1, None, range(12)), (5, None, [0, 5, 10]), (1, 3, [0, 1, 2]), (4, 2, [0, 4]), (20, None, [0])],
)
def test_frames_by_number(tmp_path: Path, every: int, limit: int | None, numbers: list[int]) -> None:
    with Video(clip(tmp_path / "a.avi")) as video:
        assert video.frames == len(LEVELS) == 12
        found = list(video.read(every, limit))
    assert [number for number, _ in found] == list(numbers)
    for number, pixels in found:
        assert (pixels.shape, pixels.dtype) == ((96, 128, 3), np.uint8)
        assert abs(float(pixels.mean()) - LEVELS[number]) < 3


def test_a_camera_is_opened_by_its_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, opened = str(clip(tmp_path / "a.avi")), cv2.VideoCapture
    monkeypatch.setattr(cv2, "VideoCapture", lambda source: opened(path if source == 3 else "none"))
    with Video(3) as camera:
        assert (camera.name, camera.frames, camera.is_camera) == ("camera 3", None, True)
        assert [number for number, _ in camera.read(limit=4)] == [0, 1, 2, 3]
    with pytest.raises(ImageError, match="camera 2: there is no such camera"):
        Video(2)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "not a video that OpenCV can decode: it is empty"),
        (b"PK\x03\x04" + bytes(99), "it is a zip archive"),
        (b"no video, but a few words", "it is text"),
        (None, "No such file"),
    ],
)
def test_what_is_no_video(tmp_path: Path, content: bytes | None, reason: str) -> None:
    path = tmp_path / "a.mp4"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ImageError, match=reason) as error:
        list(Video(path).read())
    assert str(error.value).startswith(f"{path}: ")


def test_frames_of_too_many_pixels(tmp_path: Path) -> None:
    with (
        Video(clip(tmp_path / "a.avi"), max_pixels=1000) as video,
        pytest.raises(ImageError, match=r"frame 0: .*1,000"),
    ):
        list(video.read())


def test_a_video_that_is_cut_off_gives_its_frames_and_then_says_so(tmp_path: Path) -> None:
    path = clip(tmp_path / "a.avi")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    found = []
    with Video(path) as video, pytest.raises(ImageError, match=r"ends after \d of 12 frames"):
        found.extend(video.read())
    assert 2 < len(found) < 9
