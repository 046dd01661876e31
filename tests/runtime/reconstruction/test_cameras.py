"""Which images share a camera, and what is known of it."""

from __future__ import annotations

import pytest

from elf_runtime import SettingError
from elf_runtime.reconstruction import Calibration, Camera, exhaustive, sequential, shared_cameras
from elf_runtime.reconstruction.cameras import doubts

WIDE, TALL = (480, 640), (640, 480)
SIZES = {"a/1.jpg": WIDE, "a/2.jpg": WIDE, "b/1.jpg": WIDE, "b/2.jpg": TALL, "3.jpg": WIDE}
K = [[600.0, 0, 319.5], [0, 610.0, 239.5], [0, 0, 1]]


def groups(cameras: dict[str, Camera]) -> list[list[str]]:
    by_camera: dict[Camera, list[str]] = {}
    for name, camera in cameras.items():
        by_camera.setdefault(camera, []).append(name)
    return list(by_camera.values())


def test_the_images_of_a_folder_share_a_camera_where_their_sizes_are_the_same() -> None:
    cameras = shared_cameras(SIZES)
    assert list(cameras) == list(SIZES)
    assert groups(cameras) == [["a/1.jpg", "a/2.jpg"], ["b/1.jpg"], ["b/2.jpg"], ["3.jpg"]]
    assert cameras["b/2.jpg"].image_size == TALL


def test_another_focal_length_is_another_camera_of_a_folder_and_the_middle_one_for_all() -> None:
    sizes = dict.fromkeys(("1.jpg", "2.jpg", "3.jpg", "4.jpg"), WIDE)
    focals = {"1.jpg": 500.0, "2.jpg": 500.0, "3.jpg": 900.0, "4.jpg": None}
    cameras = shared_cameras(sizes, focals=focals)
    assert groups(cameras) == [["1.jpg", "2.jpg"], ["3.jpg"], ["4.jpg"]]
    assert [(c.params[0], c.focal_known) for c in dict.fromkeys(cameras.values())] == [
        (500.0, True), (900.0, True), (1.2 * 640, False),
    ]  # fmt: skip
    (camera,) = dict.fromkeys(shared_cameras(sizes, "all", focals=focals).values())
    assert (camera.model, camera.params, camera.focal_known) == ("SIMPLE_RADIAL", (500.0, 320.0, 240.0, 0.0), True)


def test_each_image_may_have_its_own() -> None:
    assert len(groups(shared_cameras(SIZES, "image"))) == len(SIZES)


def test_a_matrix_of_opencv_s_has_its_principal_point_half_a_pixel_further_in_colmap() -> None:
    assert Calibration.of_matrix(K) == Calibration("PINHOLE", (600.0, 610.0, 320.0, 240.0))
    camera = shared_cameras({"a.jpg": WIDE}, calibration=Calibration.of_matrix(K))["a.jpg"]
    assert (camera.params, camera.focal_known) == ((600.0, 610.0, 320.0, 240.0), True)


def test_a_calibration_in_colmap_s_own_words_is_taken_as_it_is() -> None:
    parsed = Calibration.parse("opencv:600,610,320,240,1e-2,-0.1,0,0")
    assert parsed == Calibration("OPENCV", (600.0, 610.0, 320.0, 240.0, 0.01, -0.1, 0.0, 0.0))


@pytest.mark.parametrize("text", ["PINHOLE", "PINHOLE:", ":1,2", "PINHOLE:600,x,1,1", "PINHOLE:600,inf,1,1", ""])
def test_what_is_no_calibration_is_refused(text: str) -> None:
    with pytest.raises(SettingError, match=r"is not MODEL:p1,p2"):
        Calibration.parse(text)


def test_what_does_not_fit_together_is_refused() -> None:
    with pytest.raises(SettingError, match=r"one camera takes images of one size, and a/1.jpg has 640x480 pixels, b/2"):
        shared_cameras(SIZES, "all")
    with pytest.raises(SettingError, match=r"a calibration is of one size"):
        shared_cameras(SIZES, calibration=Calibration.of_matrix(K))
    with pytest.raises(SettingError, match=r"shared by folder, all, image, not 'none'"):
        shared_cameras(SIZES, "none")
    with pytest.raises(SettingError, match=r"no skew, and K's is 2"):
        Calibration.of_matrix([[600.0, 2.0, 320.0], [0, 610.0, 240.0], [0, 0, 1]])


def test_pairs() -> None:
    names = ["a", "b", "c", "d"]
    assert exhaustive(names) == [("a", "b"), ("a", "c"), ("a", "d"), ("b", "c"), ("b", "d"), ("c", "d")]
    assert sequential(names, 2) == [("a", "b"), ("a", "c"), ("b", "c"), ("b", "d"), ("c", "d")]
    assert sequential(names, 9) == exhaustive(names)
    assert sequential(names, 1) == [("a", "b"), ("b", "c"), ("c", "d")]
    with pytest.raises(SettingError, match="1 or more, not 0"):
        sequential(names, 0)


def estimated(focal: float, distortion: float = 0.0, size: tuple[int, int] = WIDE) -> Camera:
    return Camera("SIMPLE_RADIAL", (focal, 320.0, 240.0, distortion), size)


def test_cameras_that_are_hardly_possible_are_named() -> None:
    start = {name: Camera.guessed(WIDE) for name in "abc"}  # 768 px
    good = estimated(640.0, -0.3)
    assert doubts(dict.fromkeys("abc", good), start) == []
    one = estimated(2424.0)
    assert doubts(dict.fromkeys("abc", one), start) == ["a: focal length 2424 px, where the search began with 768"]
    assert doubts({"b": estimated(380.0)}, start) == ["b: focal length 380 px, where the search began with 768"]
    assert doubts({"a": estimated(828.0, 3.9)}, start) == ["a: coefficient of distortion 3.9"]
    assert doubts({"a": estimated(828.0, -0.6)}, start) == ["a: coefficient of distortion -0.6"]
    apart = {"a": estimated(828.0), "b": estimated(1304.0), "c": estimated(1000.0)}
    assert doubts(apart, start) == ["images of 640x480 pixels: focal lengths from 828 to 1304 px"]
    assert doubts({"a": estimated(800.0), "b": estimated(1300.0, size=TALL)}, start) == []


def test_a_camera_that_stayed_as_given_is_in_no_doubt() -> None:
    fisheye = estimated(300.0, 0.9)
    assert doubts({"a": estimated(300.0, 0.9)}, {"a": fisheye}) == []
