"""Strecha's scenes: cameras, depth maps, folders, and sizes that don't agree."""

from __future__ import annotations

import shutil

import cv2
import numpy as np
import pytest
from scenes import SIZE, WORKING, between, write_strecha

from elf_eval.data import open_dataset
from elf_eval.data.strecha import read_camera
from elf_eval.errors import EvalError


def test_strecha_with_depth(tmp_path):
    write_strecha(tmp_path / "wall", depth=True)
    (pair,) = open_dataset(f"strecha:{tmp_path}").pairs
    truth = between(pair, None)
    # One unit at a distance of 5 with a focal length of 100: 20 pixels to the left.
    points = np.array([[100.0, 50.0], [10.0, 10.0]])
    there = truth.forward(points)
    assert there[0] == pytest.approx([80.0, 50.0])
    assert there[1] == pytest.approx([-10.0, 10.0])  # out of the second image, where it will be dropped
    assert truth.backward(there[:1]) == pytest.approx(points[:1])
    assert truth.pose.translation == pytest.approx([-1.0, 0, 0])
    small = between(pair, WORKING).forward((points[:1] + 0.5) * [0.8, 0.75] - 0.5)
    assert small == pytest.approx((there[:1] + 0.5) * [0.8, 0.75] - 0.5)


def test_a_camera_file_s_point_lands_where_it_says(tmp_path):
    """x ~ K R^T (X - C), with a rotation that its transpose is not."""
    rotation, centre = cv2.Rodrigues(np.array([0.1, 0.2, 0.3]))[0], np.array([3.0, -2.0, 1.0])
    numbers = [100, 0, 50, 0, 100, 40, 0, 0, 1, 0, 0, 0, *rotation.ravel(), *centre, 100, 80]
    (tmp_path / "a.camera").write_text(" ".join(map(repr, map(float, numbers))))
    intrinsics, to_camera = read_camera(tmp_path / "a.camera")
    assert intrinsics == pytest.approx(np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]]))
    point = np.array([3.0, 1.0, 9.0])
    assert (to_camera @ [*point, 1.0])[:3] == pytest.approx(rotation.T @ (point - centre))


def test_depth_maps_beside_the_images_in_the_scene_s_folder_or_elsewhere(tmp_path):
    """`elf-eval depth strecha:ROOT --out ROOT` puts them into the scene's folder, also of the publishers' layout."""
    root, scene = tmp_path / "root", tmp_path / "root" / "wall"
    root.mkdir()
    write_strecha(scene, depth=True)
    for folder, ending in (("images", "*.png"), ("gt_dense_cameras", "*.camera")):
        (scene / folder).mkdir()
        for path in scene.glob(ending):
            path.rename(scene / folder / path.name)
    assert between(open_dataset(f"strecha:{root}").pairs[0]).forward is not None
    (tmp_path / "depth" / "wall").mkdir(parents=True)
    for path in scene.glob("*.npy"):
        path.rename(tmp_path / "depth" / "wall" / path.name)
    assert between(open_dataset(f"strecha:{root}").pairs[0]).forward is None
    assert between(open_dataset(f"strecha:{root}?depth={tmp_path / 'depth'}").pairs[0]).forward is not None


def test_a_folder_of_depth_without_a_map_of_any_image_is_refused(tmp_path):
    write_strecha(tmp_path / "wall", depth=True)
    for folder in (tmp_path / "nowhere", tmp_path / "wall"):
        with pytest.raises(EvalError, match=rf"no depth map SCENE/STEM\.depth\.npy of any image in {folder}$"):
            open_dataset(f"strecha:{tmp_path / 'wall'}?depth={folder}")


@pytest.mark.parametrize(("option", "count"), [("", 3), ("?step=1", 2), ("?step=2", 3)])
def test_strecha_pairs_at_most_so_many_apart(tmp_path, option, count):
    write_strecha(tmp_path / "wall", depth=False)
    for name in ("0001.png", "0001.png.camera"):
        shutil.copy(tmp_path / "wall" / name, tmp_path / "wall" / name.replace("0001", "0002"))
    assert len(open_dataset(f"strecha:{tmp_path}{option}").pairs) == count


def test_strecha_without_depth_knows_the_pose_alone(tmp_path):
    write_strecha(tmp_path / "wall", depth=False)
    truth = between(open_dataset(f"strecha:{tmp_path}").pairs[0])
    assert truth.forward is None
    assert truth.pose is not None
    (tmp_path / "wall" / "0001.png.camera").unlink()
    with pytest.raises(EvalError, match=r"0001\.png\.camera"):
        open_dataset(f"strecha:{tmp_path}")


def resize_images(folder, size):
    for path in folder.glob("*.png"):
        cv2.imwrite(str(path), cv2.resize(cv2.imread(str(path)), size))


def test_strecha_images_of_another_size_than_the_cameras_are_refused(tmp_path):
    write_strecha(tmp_path / "wall", depth=False)
    resize_images(tmp_path / "wall", (50, 40))
    with pytest.raises(EvalError, match=r"wall/0000\.png: 50x40 pixels, but 0000\.png\.camera is for 200x160"):
        open_dataset(f"strecha:{tmp_path}")


@pytest.mark.parametrize("shape", [(80, 100), (SIZE[0], SIZE[1])])
def test_strecha_depth_of_another_size_than_the_image_is_refused(tmp_path, shape):
    write_strecha(tmp_path / "wall", depth=True)
    np.save(tmp_path / "wall" / "0001.depth.npy", np.full(shape, 5.0, np.float32))
    say = rf"0001\.depth\.npy: a depth map of {shape[1]}x{shape[0]} for 0001\.png of 200x160 pixels"
    with pytest.raises(EvalError, match=say):
        open_dataset(f"strecha:{tmp_path}")


@pytest.mark.parametrize("array", [np.zeros((3, 4, 5)), np.full((160, 200), "deep")])
def test_a_depth_map_that_is_none_is_named(tmp_path, array):
    write_strecha(tmp_path / "wall", depth=True)
    np.save(tmp_path / "wall" / "0000.depth.npy", array)
    with pytest.raises(EvalError, match=r"0000\.depth\.npy: a depth map is numbers of shape \(H, W\), not "):
        open_dataset(f"strecha:{tmp_path}")


@pytest.mark.parametrize("inner", ["", "wall"])
def test_strecha_as_published(tmp_path, inner):
    """``images/`` and ``gt_dense_cameras/``, of one scene or of several."""
    scene = tmp_path / "wall"
    write_strecha(scene, depth=True)
    for folder, pattern in (("gt_dense_cameras", "*.camera"), ("images", "000*")):
        files = list(scene.glob(pattern))
        (scene / folder).mkdir()
        for path in files:
            path.rename(scene / folder / path.name)
    (pair,) = open_dataset(f"strecha:{tmp_path / 'wall' if inner else tmp_path}").pairs
    assert (pair.scene, pair.name) == ("wall", "wall/0000.png - wall/0001.png")
    assert between(pair, None).forward(np.array([[100.0, 50.0]]))[0] == pytest.approx([80.0, 50.0])


def test_strecha_pairs_of_the_first_image(tmp_path):
    write_strecha(tmp_path / "wall", depth=False)
    for name in ("0001.png", "0001.png.camera"):
        for other in ("0002", "0003"):
            shutil.copy(tmp_path / "wall" / name, tmp_path / "wall" / name.replace("0001", other))
    firsts = [p.second.path.stem for p in open_dataset(f"strecha:{tmp_path}?pairs=first").pairs]
    assert firsts == ["0001", "0002", "0003"]
    assert len(open_dataset(f"strecha:{tmp_path}?pairs=first&step=2").pairs) == 2
    assert len(open_dataset(f"strecha:{tmp_path}?pairs=all").pairs) == 6
    with pytest.raises(EvalError, match="pairs=last: expected all or first"):
        open_dataset(f"strecha:{tmp_path}?pairs=last")


def test_the_published_scene_opens(shared):
    if not (shared / "data" / "strecha" / "entry-P10").is_dir():
        pytest.skip("no strecha/entry-P10 there")
    pairs = open_dataset(f"strecha:{shared / 'data' / 'strecha'}?pairs=first").pairs
    assert len(pairs) == 9
    assert {pair.scene for pair in pairs} == {"entry-P10"}
