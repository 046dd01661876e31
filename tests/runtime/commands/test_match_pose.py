"""elf-match --ransac essential: the relative pose of rendered views, and what a camera may be."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime import ElfRuntime
from elf_runtime.commands.match import main
from exif_files import exif, jpeg

from .scenes import rendered

SIZE = (480, 640)
K_A = np.array([[620.0, 0.0, 319.5], [0.0, 620.0, 239.5], [0.0, 0.0, 1.0]])
K_B = np.array([[560.0, 0.0, 330.0], [0.0, 570.0, 225.0], [0.0, 0.0, 1.0]])
TURN = cv2.Rodrigues(np.array([0.03, -0.12, 0.05]))[0]
MOVE = np.array([0.9, 0.1, -0.3])
ALONE = ["--threads", "1"]


@pytest.fixture
def views(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """One scene by one camera twice, and by another one from the second place."""
    monkeypatch.chdir(tmp_path)
    still = np.eye(3), np.zeros(3)
    for name, K, pose in (("a", K_A, still), ("b", K_A, (TURN, MOVE)), ("c", K_B, (TURN, MOVE))):
        cv2.imwrite(f"{name}.png", rendered(K, *pose, SIZE))
    return ["a.png", "b.png", "c.png"]


def errors(pair: dict[str, list[float]]) -> tuple[float, float]:
    """Angles between the found and the true rotation, and between the directions, in degrees."""
    rotation, direction = np.array(pair["rotation"]), np.array(pair["translation"])
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    assert np.linalg.norm(direction) == pytest.approx(1.0)
    turned = np.clip((np.trace(rotation.T @ TURN) - 1) / 2, -1, 1)
    along = np.clip(direction @ MOVE / np.linalg.norm(MOVE), -1, 1)
    return float(np.degrees(np.arccos(turned))), float(np.degrees(np.arccos(along)))


def test_the_pose_of_one_camera(views: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    Path("camera.txt").write_text("# calibrated\n" + "\n".join(" ".join(map(str, row)) for row in K_A))
    for camera in ("620,620,319.5,239.5", "620", "camera.txt"):
        options = ["--ransac", "essential", "--ratio", "0.9", "--K", camera, "--json", "m.json", "--save", "m.npz"]
        assert main([*views[:2], *options, *ALONE]) == 0
        pair = json.loads(Path("m.json").read_text())
        assert pair["ransac_threshold"] == 1.0
        assert pair["K"] == [K_A.tolist(), K_A.tolist()]
        assert pair["inliers"] > 60
        turned, along = errors(pair)
        assert turned < 0.5
        assert along < 3.0
        angle = np.degrees(np.linalg.norm(cv2.Rodrigues(np.array(pair["rotation"]))[0]))
        assert f"essential inliers, turned by {angle:.1f} degrees -> m.npz" in capsys.readouterr().out
        with np.load("m.npz") as saved:
            for name in ("rotation", "translation", "matrix"):
                np.testing.assert_array_equal(saved[name], pair[name])
            np.testing.assert_array_equal(saved["K_b"], K_A)
            # y2^T E y1 = 0 of rays, to within a pixel over the focal length.
            rays = [np.column_stack([saved[f"points_{s}"], np.ones(len(saved["pairs"]))]) for s in "ab"]
            rays = [one[saved["inliers"]] @ np.linalg.inv(K_A).T for one in rays]
            lines = rays[0] @ saved["matrix"].T
            away = np.abs((rays[1] * lines).sum(axis=1)) / np.linalg.norm(lines[:, :2], axis=1)
            assert away.max() * 620 < 1.5


def test_two_cameras_and_a_folder(views: list[str]) -> None:
    second = ["--K", "620,620,319.5,239.5", "--K-b", "560,570,330,225"]
    assert main(["a.png", "c.png", "--ransac", "essential", "--ratio", "0.9", *second, "--json", "m.json", *ALONE]) == 0
    pair = json.loads(Path("m.json").read_text())
    assert pair["K"] == [K_A.tolist(), K_B.tolist()]
    assert max(np.array(errors(pair)) / (0.5, 3.0)) < 1
    Path("others").mkdir()
    Path("c.png").rename("others/c.png")
    more = ["--ransac", "essential", "--ratio", "0.9", *second, "--json", "n.json", *ALONE]
    assert main(["a.png", "others", *more]) == 0
    (found,) = json.loads(Path("n.json").read_text())["pairs"]
    assert {name: found[name] for name in ("matrix", "rotation", "translation", "K")}.items() <= pair.items()


def test_the_focal_length_of_exif(views: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    # 640x480 has a diagonal of 800 pixels; 34 mm of 43.27 are 628.7 of them.
    focal = 34 * 800 / np.hypot(36, 24)
    for name in "ab":
        Path(f"{name}.jpg").write_bytes(jpeg(exif({41989: (3, 34)}), pixels=cv2.imread(f"{name}.png")))
    options = ["--ransac", "essential", "--ratio", "0.9", "--json", "m.json", *ALONE]
    assert main(["a.jpg", "b.jpg", *options]) == 0
    pair = json.loads(Path("m.json").read_text())
    np.testing.assert_allclose(pair["K"], [[[focal, 0, 319.5], [0, focal, 239.5], [0, 0, 1]]] * 2)
    assert max(np.array(errors(pair)) / (1.0, 5.0)) < 1
    capsys.readouterr()
    assert main(["a.jpg", "b.png", *options]) == 1
    assert capsys.readouterr().err == "elf-match: error: b.png: no focal length in its EXIF data; give --K\n"
    assert main(["a.png", ".", *options]) == 1  # said once, though each pair needs it
    assert capsys.readouterr().err == "elf-match: error: a.png: no focal length in its EXIF data; give --K\n"


def test_no_pose_of_unrelated_images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    for name in "ab":
        cv2.imwrite(f"{name}.png", rng.integers(0, 256, (240, 320, 3), np.uint8))
    options = ["--ransac", "essential", "--K", "300", "--json", "m.json", "--save", "m.npz"]
    assert main(["a.png", "b.png", *options, *ALONE]) == 0
    pair = json.loads(Path("m.json").read_text())
    assert (pair["supported"], pair["matrix"], pair["rotation"], pair["translation"]) == (False, None, None, None)
    with np.load("m.npz") as saved:
        assert np.isnan(saved["rotation"]).all()
        assert saved["translation"].shape == (3,)
        assert not saved["inliers"].any()


@pytest.mark.parametrize(
    ("options", "status", "reason"),
    [
        (["--K", "500"], 2, "--K goes with --ransac essential"),
        (["--ransac", "homography", "--K", "500"], 2, "--K goes with --ransac essential"),
        (["--ransac", "essential", "--K-b", "500"], 2, "--K-b is a second camera beside that of --K"),
        (["--ransac", "essential", "--K", "500,500"], 2, "--K 500,500: a camera is fx,fy,cx,cy"),
        (["--ransac", "essential", "--K=-500"], 2, "--K -500: a camera is"),
        (["--ransac", "essential", "--K", "0,500,1,1"], 2, "--K 0,500,1,1: a camera is"),
        (["--ransac", "essential", "--K="], 2, "--K : not fx,fy,cx,cy"),
        (["--ransac", "essential", "--K", "nan"], 2, "--K nan: a camera is"),
        (["--ransac", "essential", "--K", "500,x,1,1"], 2, "--K 500,x,1,1: not fx,fy,cx,cy"),
        (["--ransac", "essential", "--K", "absent.txt"], 2, "--K absent.txt: not fx,fy,cx,cy"),
        (["--ransac", "essential", "--K", "transposed.txt"], 2, "--K transposed.txt: a camera is"),
        (["--ransac", "essential", "--K", "words.txt"], 2, "--K words.txt: a camera is"),
        (["--ransac", "essential", "--K", "500", "--K-b", "."], 1, "--K-b: .: not a file but a folder"),
        (["--ransac", "essential", "--K", "500", "--ransac-threshold", "0"], 2, "--ransac-threshold 0"),
    ],
)
def test_one_line_for_what_is_wrong(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    options: list[str],
    status: int,
    reason: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ElfRuntime, "detect", None)
    Path("transposed.txt").write_text("500 0 0\n0 500 0\n320 240 1\n")
    Path("words.txt").write_text("SIMPLE_PINHOLE 640 480 500 320 240\n")
    assert main(["a.png", "b.png", *options]) == status
    error = capsys.readouterr().err
    assert error.startswith("elf-match: error: ")
    assert error.count("\n") == 1
    assert reason in error


def test_a_principal_point_far_outside_the_image(views: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    error = "elf-match: error: --K: the principal point 1e+09,1e+09 lies far outside an image of 640x480 pixels\n"
    for command in (["a.png", "b.png"], [".", "--pairs", "sequential"]):
        assert main([*command, "--ransac", "essential", "--K", "500,500,1e9,1e9", *ALONE]) == 1
        assert capsys.readouterr().err == error
