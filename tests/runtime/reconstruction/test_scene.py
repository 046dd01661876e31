"""elf-reconstruct and elf-localize on a rendered room whose cameras are known."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from elf_runtime.commands import localize, reconstruct
from elf_runtime.reconstruction import read_model
from helpers import ROOT, turned_jpeg
from room import FOCAL, SIZE, Float, K, View, moved, similarity, similarity_error, view, views

pycolmap = pytest.importorskip("pycolmap", reason="pycolmap, of the extra sfm, is not installed")

THREADS = ("--threads", "1")
GIVEN = ("--K", ",".join(f"{value:g}" for value in (K[0, 0], K[1, 1], K[0, 2], K[1, 2])))
# What half a pixel is at the distance of the back wall, in metres: keypoints are placed that well, and each camera by
# hundreds of them.
PRECISION = 0.5 / FOCAL * 4.2
TURNED = "inner/4.jpg"


def run(command: Any, *arguments: object) -> int:
    return int(command.main([str(argument) for argument in (*arguments, *THREADS)]))


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nine views, one of them a JPEG that EXIF data ask to turn, in a folder of its own."""
    folder = tmp_path_factory.mktemp("room")
    (folder / "inner").mkdir()
    for number, seen in enumerate(views()):
        if number == 4:
            (folder / TURNED).write_bytes(turned_jpeg(seen.image))
        else:
            cv2.imwrite(str(folder / f"{number}.png"), seen.image)
    return folder


@pytest.fixture(scope="module")
def scene(photos: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "scene"
    assert run(reconstruct, photos, "-o", out, *GIVEN) == 0
    return out


def record(scene: Path) -> dict[str, Any]:
    return json.loads((scene / "reconstruction.json").read_text())


def centers(found: dict[str, Any]) -> Float:
    """By the number of the view."""
    images = found["images"]
    return np.array([images[name]["center"] for name in sorted(images, key=lambda name: Path(name).name)])


TRUE = np.array([seen.center for seen in views()])


def test_all_cameras_are_placed_where_they_were(scene: Path) -> None:
    found = record(scene)
    assert found["registered"] == len(found["images"]) == 9
    errors = similarity_error(centers(found), TRUE)
    assert np.sqrt((errors**2).mean()) < PRECISION
    assert errors.max() < 2 * PRECISION
    assert found["reprojection_error"] < 0.6
    assert found["track_length"] > 4
    assert found["points"] > 1000
    assert found["models"] == [9]
    assert found["pairs"]["verified_pairs"] == found["pairs"]["count"] == 36


def test_known_intrinsics_stay(scene: Path) -> None:
    for camera in record(scene)["cameras"]:
        assert camera["model"] == "PINHOLE"
        np.testing.assert_array_equal(camera["params"], [K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5])


def test_the_poses_look_where_the_cameras_looked(scene: Path) -> None:
    model = read_model(scene / "sparse" / "0")
    poses = [model.poses[name] for name in sorted(model.poses, key=lambda name: Path(name).name)]
    _, world, _ = similarity(np.array([pose.center for pose in poses]), TRUE)
    for pose, seen in zip(poses, views(), strict=True):
        assert angle(pose.rotation, seen.rotation @ world) < 0.1


def angle(first: Float, second: Float) -> float:
    """Between two rotations, in degrees."""
    return float(np.degrees(np.linalg.norm(cv2.Rodrigues(first @ second.T)[0])))


def test_pycolmap_reads_what_is_there(scene: Path) -> None:
    found = record(scene)
    colmap = pycolmap.Reconstruction(str(scene / "sparse" / "0"))
    assert colmap.num_reg_images() == 9
    assert colmap.num_points3D() == found["points"]
    with pycolmap.Database.open(str(scene / "database.db")) as database:
        for image in database.read_all_images():
            with np.load(scene / "features" / f"{image.name}.npz") as saved:
                read = database.read_keypoints(image.image_id)
                np.testing.assert_allclose(read[:, :2], saved["keypoints"] + 0.5, atol=1e-3)
                assert tuple(saved["image_size"]) == SIZE  # as stored, not as EXIF data would have it turned


def test_the_points_have_the_colours_of_the_walls(scene: Path) -> None:
    model = read_model(scene / "sparse" / "0")
    assert model.xyz.shape == model.colors.shape == (record(scene)["points"], 3)
    name, track = next(iter(model.tracks.items()))
    keypoint = np.flatnonzero(track >= 0)
    camera, pose = model.cameras[name], model.poses[name]
    seen = model.xyz[track[keypoint]] @ pose.rotation.T + pose.translation
    fx, fy, cx, cy = camera.params
    with np.load(scene / "features" / f"{name}.npz") as saved:
        pixels = saved["keypoints"][keypoint] + 0.5
    errors = np.linalg.norm(seen[:, :2] / seen[:, 2:] * (fx, fy) + (cx, cy) - pixels, axis=1)
    assert np.median(errors) < 0.6
    assert model.colors.std() > 30


def test_the_picture_shows_points_and_cameras(scene: Path) -> None:
    picture = cv2.imread(str(scene / "reconstruction.png"))
    green = (np.abs(picture.astype(int) - (90, 210, 60)) < 60).all(axis=2)
    assert green[:, :800].sum() > 500
    assert green[:, 806:].sum() > 500
    assert ((picture.max(axis=2) >= 100) & ~green).sum() > 2000


def test_estimated_intrinsics_come_near_the_true_ones(
    photos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("--share", "all", "--pairs", "sequential:5", "--json", "-")
    assert run(reconstruct, photos, "-o", tmp_path / "out", *options) == 0
    captured = capsys.readouterr()
    found = json.loads(captured.out)
    assert found == record(tmp_path / "out")
    (camera,) = found["cameras"]
    assert camera["model"] == "SIMPLE_RADIAL"
    assert camera["params"][0] == pytest.approx(FOCAL, rel=0.02)
    assert found["registered"] == 9
    assert np.sqrt((similarity_error(centers(found), TRUE) ** 2).mean()) < PRECISION
    for line in (
        "9 of 9 images registered",
        "camera of 9 images, 640x480: SIMPLE_RADIAL, focal length 768 px, a guess",
        "9 images placed",
    ):
        assert line in captured.err
    assert found["pairs"]["rule"] == "sequential:5"


@pytest.fixture(scope="module")
def new() -> View:
    """A view from nearer than all that the model was made of."""
    return view((0.5, -0.3, -0.9), (-0.6, 0.5, 2.9))


@pytest.mark.parametrize("known", [True, False])
def test_a_new_image_is_localised(
    known: bool, new: View, scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Cut to a size that no camera of the model has, around the optical axis, its focal length is estimated too.
    image = new.image if known else new.image[16:456, 25:625]
    cv2.imwrite(str(tmp_path / "new.png"), image)
    assert run(localize, scene, tmp_path / "new.png", "--json", tmp_path / "poses.json") == 0
    assert "inliers of" in capsys.readouterr().out
    (found,) = json.loads((tmp_path / "poses.json").read_text())["images"]
    scale, world, shift = similarity(centers(record(scene)), TRUE)
    center = moved(np.array([found["center"]]), scale, world, shift)[0]
    place, turn = (2 * PRECISION, 0.1) if known else (10 * PRECISION, 0.3)  # focal length and distance trade off
    assert np.linalg.norm(center - new.center) < place
    w, *xyz = found["qvec"]
    rotation = pycolmap.Rotation3d(np.array([*xyz, w])).matrix()
    assert angle(rotation, new.rotation @ world) < turn
    np.testing.assert_allclose(-rotation.T @ found["tvec"], found["center"], atol=1e-9)
    assert found["inliers"] > 300
    assert found["camera"]["params"][0] == pytest.approx(FOCAL, rel=1e-6 if known else 0.03)


def test_a_mask_holds_what_is_localised_by(new: View, scene: Path, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "new.png"), new.image)
    inliers = []
    for share in (1.0, 0.5):
        mask = np.zeros(new.image.shape[:2], np.uint8)
        mask[:, : round(share * mask.shape[1])] = 255
        cv2.imwrite(str(tmp_path / "mask.png"), mask)
        words = (scene, tmp_path / "new.png", "--mask", tmp_path / "mask.png", "--json", tmp_path / "poses.json")
        assert run(localize, *words) == 0
        inliers.append(json.loads((tmp_path / "poses.json").read_text())["images"][0]["inliers"])
    assert 50 < inliers[1] < 0.8 * inliers[0]


def test_an_image_of_another_scene_has_no_place_in_this_one(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "no.png").write_text("no image")
    images = (ROOT / "demo" / "palace.jpg", tmp_path / "no.png")
    assert run(localize, scene, *images, "--json", "-") == 1
    captured = capsys.readouterr()
    other, no_image = json.loads(captured.out)["images"]
    assert other["localized"] is False
    assert no_image["error"] in captured.err
    assert "palace.jpg: not placed" in captured.err


def test_a_damaged_image_is_left_out_and_a_scene_is_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    few, out = tmp_path / "few", tmp_path / "out"
    few.mkdir()
    for number in (0, 2, 4, 6):
        cv2.imwrite(str(few / f"{number}.png"), views()[number].image)
    (few / "5.png").write_bytes((few / "4.png").read_bytes()[:5000])
    out.mkdir()
    (out / "reconstruction.json").write_text("{}")
    (out / "old").write_text("")
    given = f"SIMPLE_RADIAL:{FOCAL},{K[0, 2] + 0.5},{K[1, 2] + 0.5},0"
    options = ("--camera", given, "--refine-intrinsics", "--share", "image", "--overwrite", "--max-keypoints", 800)
    assert run(reconstruct, few, "-o", out, *options) == 1
    assert "5.png: the PNG file is cut off" in capsys.readouterr().err
    found = record(out)
    assert list(found["images"]) == ["0.png", "2.png", "4.png", "6.png"]
    assert {image["keypoints"] for image in found["images"].values()} == {800}
    assert len(found["cameras"]) == found["registered"] == 4
    for camera in found["cameras"]:
        focal, x, y, k = camera["params"]
        assert focal == pytest.approx(FOCAL, rel=0.05)
        assert (x, y) == (K[0, 2] + 0.5, K[1, 2] + 0.5)
        assert focal != FOCAL
        assert k != 0
    assert not (out / "old").exists()


def test_the_python_of_the_page_runs(new: View, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (ROOT / "docs" / "pipelines.md").read_text(encoding="utf-8")
    (tmp_path / "photos").mkdir()
    for number in (0, 2, 4, 6):
        cv2.imwrite(str(tmp_path / "photos" / f"{number}.jpg"), views()[number].image)
    cv2.imwrite(str(tmp_path / "new.png"), new.image)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(page.split("```python\n")[1].split("```")[0], names)
    (model,) = names["models"]
    assert len(model.poses) == 4
    assert (tmp_path / "out" / "0" / "images.bin").is_file()
    assert names["found"].inliers > 100


def test_sigterm_while_images_are_placed_leaves_nothing(photos: Path, tmp_path: Path) -> None:
    """Although pycolmap's logging installs a handler of its own, which ends the process at once."""
    command = [sys.executable, "-m", "elf_runtime.commands.reconstruct", str(photos), "-o", str(tmp_path / "out")]
    env = {**os.environ, "PYTHONPATH": str(ROOT / "runtime")}
    with subprocess.Popen(
        [*command, *GIVEN, *THREADS], env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if "3 images placed" in line:
                process.terminate()
                break
        assert process.stdout.read().splitlines()[-1] == "elf-reconstruct: terminated"
    assert process.returncode == 143
    assert list(tmp_path.iterdir()) == []
