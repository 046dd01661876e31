"""Depth by a sweep of planes, against the true depth of a rendered room and of a plane."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import error_of

from elf_eval.cli import main
from elf_eval.data import open_dataset
from elf_eval.data.depth import read_depth
from elf_eval.data.plane_sweep import Neighbour, agreeing, sweep
from room import _WALLS, SIDE, SIZE, K, views, write_as_strecha

COUNT = 3


def true_depth(view) -> np.ndarray:
    """(H, W): where each pixel's ray meets a wall of the room; 0 where it meets none."""
    y, x = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    rays = view.rotation.T @ np.linalg.inv(K) @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    depth = np.zeros(x.size)
    for corner, along, down in _WALLS.values():
        normal = np.cross(along, down)
        z = normal @ (np.array(corner) - view.center) / (normal @ rays)
        place = view.center[:, None] + rays * z - np.array(corner)[:, None]
        u, v = np.array(along) @ place, np.array(down) @ place
        inside = (z > 0) & (u >= 0) & (u <= SIDE) & (v >= 0) & (v <= SIDE)
        depth[inside] = z[inside]
    return depth.reshape(SIZE)


@pytest.fixture(scope="module")
def room_folder(tmp_path_factory) -> Path:
    scene = tmp_path_factory.mktemp("strecha") / "room"
    write_as_strecha(scene, views()[3 : 3 + COUNT])
    return scene


@pytest.fixture(scope="module")
def maps(room_folder, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("depth")
    command = ["depth", f"strecha:{room_folder}", "--out", str(out), "--side", "320", "--planes", "64"]
    assert main([*command, "--threads", "1", "--quiet"]) == 0
    return out


def test_the_depth_of_a_room_is_known_to_a_percent(maps):
    for n, seen in enumerate(views()[3 : 3 + COUNT]):
        found, true = read_depth(maps / "room" / f"000{n}.depth.npy"), true_depth(seen)
        assert found.shape == SIZE
        known = (found > 0) & (true > 0)
        assert known.mean() > 0.6
        error = np.abs(found[known] - true[known]) / true[known]
        assert np.median(error) < 0.005
        assert (error < 0.05).mean() > 0.97  # what the protocol takes for hidden


def test_the_paper_s_metrics_come_from_these_maps(room_folder, maps, tmp_path):
    """By depth, SIFT repeats as by the true depth."""
    rest = ["--detector", "sift", "--cache", str(tmp_path / "c"), "--quiet", "--threads", "1"]
    truth = tmp_path / "truth" / "room"
    truth.mkdir(parents=True)
    for n, seen in enumerate(views()[3 : 3 + COUNT]):
        np.save(truth / f"000{n}.depth.npy", true_depth(seen).astype(np.float32))
    from elf_eval.run.results import Results

    found = []
    for name, folder in (("maps", maps), ("truth", tmp_path / "truth")):
        dataset = f"room=strecha:{room_folder}?pairs=first&depth={folder}"
        assert main(["run", "--dataset", dataset, *rest, "--out", str(tmp_path / name)]) == 0
        pairs = Results.load(tmp_path / name / "results.json").pairs
        found.append([(pair.metrics["rep"], pair.metrics["ms"]) for pair in pairs])
    assert len(found[0]) == COUNT - 1
    assert np.abs(np.subtract(*found)).max() < 0.04


def test_the_sweep_finds_a_plane_between_its_planes(rng):
    """A plane at depth 3 in front of two cameras side by side: a shift by f b / z pixels."""
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (60, 120)).astype(np.float32), (3, 3), 0.8)
    camera = np.array([[90.0, 0, 40], [0, 90, 30], [0, 0, 1]])
    grey, other = texture[:, 20:100].copy(), texture[:, 29:109].copy()  # 90 * 0.3 / 3 = 9 pixels
    neighbour = Neighbour(other, camera, np.eye(3), np.array([-0.3, 0.0, 0.0]))
    found = sweep(grey, camera, [neighbour], 1.5, 7.0, 40)
    inner = found[5:-5, 15:-5]
    assert (inner > 0).mean() > 0.95
    assert np.median(np.abs(inner[inner > 0] - 3.0)) < 0.01
    assert (found[:, :8] == 0).all()  # out of the neighbour's sight
    flat = sweep(np.full_like(grey, 100.0), camera, [neighbour], 1.5, 7.0, 40)
    assert (flat == 0).all()


def test_a_pixel_agrees_where_the_other_map_has_its_depth():
    camera = np.array([[90.0, 0, 40], [0, 90, 30], [0, 0, 1]])
    other = np.full((60, 80), 3.0, np.float32)
    other[:, :40] = 3.3
    view = Neighbour(other, camera, np.eye(3), np.array([-0.3, 0.0, 0.0]))
    keep, difference = agreeing(np.full((60, 80), 3.0, np.float32), camera, [(other, view)], 0.01)
    assert keep[:, 49:].all()
    assert not keep[:, :49].any()
    assert difference[30, 20] == pytest.approx(0.1)
    assert np.isinf(difference[:, :9]).all()  # out of its sight


def test_what_has_no_cameras_or_no_matches_is_refused(hpatches_folder, room_folder, tmp_path, capsys):
    command = ["--out", str(tmp_path / "o"), "--quiet", "--threads", "1"]
    (line,) = error_of(["depth", f"hpatches:{hpatches_folder}", *command], capsys)
    assert "depth comes from cameras, and they are not known" in line
    with pytest.raises(SystemExit):
        main(["depth", f"strecha:{room_folder}", "--planes", "2", *command])
    assert "argument --planes: 2 planes are too few; take 3 or more" in capsys.readouterr().err
    blank = tmp_path / "blank"
    for folder in ("images", "gt_dense_cameras"):
        (blank / folder).mkdir(parents=True)
    for path in sorted((room_folder / "gt_dense_cameras").iterdir()):
        (blank / "gt_dense_cameras" / path.name).write_text(path.read_text())
        cv2.imwrite(str(blank / "images" / path.stem), np.full((*SIZE, 3), 90, np.uint8))
    capsys.readouterr()
    (line,) = error_of(["depth", f"strecha:{blank}", *command], capsys)
    assert "blank/0000.png: only 0 points match its neighbours" in line
    assert len(open_dataset(f"strecha:{room_folder}").pairs) == COUNT
