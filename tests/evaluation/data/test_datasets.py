"""Datasets by their layout: what they find, and what they say when something is missing."""

from __future__ import annotations

import hashlib
import shutil

import cv2
import numpy as np
import pytest
from scenes import SIZE, photograph

from elf_eval.coordinates import warp
from elf_eval.data import open_dataset
from elf_eval.data.depth import depth_at, through_depth
from elf_eval.data.images import ImageRef
from elf_eval.data.strecha import read_camera
from elf_eval.data.views import RandomHomography, Rotation, Zoom, homography_through, warp_image
from elf_eval.errors import EvalError

WORKING = (160, 120)


def between(pair, size=WORKING):
    return pair.truth.at(pair.first.open(size).to_working, pair.second.open(size).to_working)


def test_hpatches_pairs_image_1_with_the_others(hpatches_folder):
    dataset = open_dataset(f"hpatches:{hpatches_folder}")
    assert [p.name for p in dataset.pairs[:2]] == [
        "i_light/1.png - i_light/2.png",
        "i_light/1.png - i_light/3.png",
    ]
    assert len(list(dataset.images())) == 6
    assert open_dataset(f"hpatches:{hpatches_folder}?part=v").scenes() == ["v_turn"]
    assert open_dataset(f"hpatches:{hpatches_folder}?scenes=i_light").scenes() == ["i_light"]


def test_homographies_follow_the_resized_images(hpatches_folder):
    pair = open_dataset(f"hpatches:{hpatches_folder}").pairs[1]
    matrix = np.reshape(pair.truth.matrix, (3, 3))
    point = np.array([[80.0, 60.0]])  # in the file's 200 x 160 pixels
    there = warp(matrix, point)
    scale = np.array([WORKING[0] / SIZE[0], WORKING[1] / SIZE[1]])
    small, small_there = (point + 0.5) * scale - 0.5, (there + 0.5) * scale - 0.5
    truth = between(pair)
    assert truth.forward(small) == pytest.approx(small_there, abs=1e-9)
    assert truth.backward(small_there) == pytest.approx(small, abs=1e-9)


def test_the_homography_leads_to_the_same_pixels(hpatches_folder):
    pair = open_dataset(f"hpatches:{hpatches_folder}").pairs[1]
    first, second = pair.first.open(WORKING).pixels, pair.second.open(WORKING).pixels
    seen = warp_image(first, between(pair).homography)
    error = np.abs(seen.astype(float) - second)[20:100, 20:140]
    assert np.median(error) < 6
    assert np.corrcoef(seen[20:100, 20:140].ravel(), second[20:100, 20:140].ravel())[0, 1] > 0.97


def test_the_eight_large_scenes_can_be_left_out(hpatches_folder, tmp_path):
    root = tmp_path / "set"
    shutil.copytree(hpatches_folder / "i_light", root / "i_light")
    shutil.copytree(hpatches_folder / "i_light", root / "i_dc")
    assert open_dataset(f"hpatches:{root}").scenes() == ["i_dc", "i_light"]
    assert open_dataset(f"hpatches:{root}?drop8=true").scenes() == ["i_light"]


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda f: (f / "H_1_3").unlink(), ["v_turn/H_1_3"]),
        (lambda f: (f / "3.png").unlink(), ["v_turn", "one image 3.*"]),
        (lambda f: (f / "H_1_2").write_text("1 0 0 0 1 0"), ["H_1_2", "3x3", "6 numbers"]),
        (lambda f: (f / "H_1_2").write_text("1 0 0 one"), ["H_1_2", "not a matrix"]),
        (lambda f: (f / "H_1_2").write_text("1 0 0 1 0 0 0 0 1"), ["H_1_2", "singular"]),
        (lambda f: shutil.copy(f / "1.png", f / "1.jpg"), ["1.jpg", "1.png"]),
    ],
)
def test_damage_is_named(hpatches_folder, tmp_path, damage, words):
    shutil.copytree(hpatches_folder, tmp_path / "set")
    damage(tmp_path / "set" / "v_turn")
    with pytest.raises(EvalError) as error:
        open_dataset(f"hpatches:{tmp_path / 'set'}")
    assert all(word in str(error.value) for word in words), error.value


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("hpatches:nowhere", "no such folder"),
        ("patches:{}", "unknown kind"),
        ("hpatches:{}?part=x", "expected i or v"),
        ("hpatches:{}?scenes=i_dark", "i_dark"),
        ("hpatches:{}?fast=true", "unknown options"),
        ("hpatches:{}?drop8=yes", "drop8=yes"),
    ],
)
def test_a_wrong_text_is_named(hpatches_folder, text, words):
    with pytest.raises(EvalError, match=words):
        open_dataset(text.format(hpatches_folder))


@pytest.mark.parametrize("inner", ["", "test/image_color"])
def test_webcam_is_the_identity_in_natural_order(tmp_path, inner):
    folder = tmp_path / "Chamonix" / inner
    folder.mkdir(parents=True)
    for n in (1, 2, 10):
        cv2.imwrite(str(folder / f"{n}.png"), photograph(n))
    pairs = open_dataset(f"webcam:{tmp_path}").pairs
    assert [p.second.path.name for p in pairs] == ["2.png", "10.png"]
    point = np.array([[30.0, 40.0]])
    assert between(pairs[0]).forward(point) == pytest.approx(point)
    assert len(open_dataset(f"webcam:{tmp_path}?limit=2").pairs) == 1


def test_rotation_and_scale_sets(hpatches_folder):
    turned = open_dataset(f"rotation:{hpatches_folder}")
    assert [p.parameter for p in turned.pairs[:6]] == [0, 40, 80, 120, 160, 200]
    centre = np.array([[79.5, 59.5]])
    right = centre + np.array([10, 0])
    for pair in turned.pairs[:6]:
        truth = between(pair)
        assert truth.forward(centre) == pytest.approx(centre)
        angle = np.radians(pair.parameter)
        assert truth.forward(right) - centre == pytest.approx(10 * np.array([[np.cos(angle), np.sin(angle)]]))
    zoomed = open_dataset(f"scale:{hpatches_folder}")
    assert [p.parameter for p in zoomed.pairs[:4]] == [1.25, 1.5, 1.75, 2.0]
    assert between(zoomed.pairs[3]).forward(right) == pytest.approx(centre + np.array([20, 0]))


def test_angles_and_factors_by_option(hpatches_folder):
    turned = open_dataset(f"rotation:{hpatches_folder}?angles=10,50,90,130,170,210")
    assert [p.parameter for p in turned.pairs] == 2 * [10, 50, 90, 130, 170, 210]
    assert turned.pairs[5].second.view == Rotation(210)
    assert turned.pairs[5].second.name == "i_light/1@rotation-210.png"
    zoomed = open_dataset(f"scale:{hpatches_folder}?scenes=v_turn&factors=0.5,3")
    assert [p.second.view for p in zoomed.pairs] == [Zoom(0.5), Zoom(3)]
    views = [open_dataset(f"rotation:{hpatches_folder}?angles={angle}").pairs[0].second for angle in ("40", "40.0")]
    assert views[0].digest(WORKING) == views[1].digest(WORKING) == turned_by_default(hpatches_folder).digest(WORKING)


def turned_by_default(folder):
    return open_dataset(f"rotation:{folder}").pairs[1].second


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("rotation:{}?angles=ten", "option angles=ten"),
        ("rotation:{}?angles=", "option angles="),
        ("rotation:{}?angles=10,inf", "different numbers"),
        ("rotation:{}?angles=10,10.0", "different numbers"),
        ("scale:{}?factors=0", "a factor is above 0"),
        ("scale:{}?angles=10", "unknown options"),
    ],
)
def test_angles_and_factors_that_are_none(hpatches_folder, text, words):
    with pytest.raises(EvalError, match=words):
        open_dataset(text.format(hpatches_folder))


def test_a_view_at_0_degrees_is_the_image_itself(hpatches_folder):
    pair = open_dataset(f"rotation:{hpatches_folder}").pairs[0]
    assert np.array_equal(pair.first.open(WORKING).pixels, pair.second.open(WORKING).pixels)


def gradient_image():
    """Integer arithmetic only: the same on every machine."""
    y, x = np.mgrid[0:48, 0:64]
    return np.stack([(3 * x + y) % 256, (x * y) % 256, (x + 5 * y) % 256], axis=2).astype(np.uint8)


@pytest.mark.parametrize(
    ("view", "digest"),
    [
        (Rotation(40), "4af6e3109bef5fc1"),
        (Zoom(1.75), "a0b539690449c564"),
        (RandomHomography(3, 0.2), "602cd8799f2ffbfb"),
    ],
)
def test_views_are_the_same_bits_everywhere(view, digest):
    seen = warp_image(gradient_image(), view.matrix((64, 48)))
    assert hashlib.sha256(seen.tobytes()).hexdigest()[:16] == digest


def test_warp_image_against_opencv(photo_file):
    pixels = ImageRef("photo", photo_file).open(None).pixels
    matrix = RandomHomography(1, 0.2).matrix((pixels.shape[1], pixels.shape[0]))
    mine = warp_image(pixels, matrix).astype(int)
    theirs = cv2.warpPerspective(pixels, matrix, (pixels.shape[1], pixels.shape[0])).astype(int)
    both = (mine > 0).all(axis=2) & (theirs > 0).all(axis=2)
    assert both.mean() > 0.5
    # OpenCV's warp rounds coordinates to 1/32 of a pixel.
    assert np.abs(mine - theirs)[both].mean() < 2


def test_a_synthetic_pair_maps_what_it_shows(tmp_path):
    for n in range(2):
        cv2.imwrite(str(tmp_path / f"{n}.png"), photograph(n))
    dataset = open_dataset(f"synthetic:{tmp_path}?count=3&strength=0.15")
    assert len(dataset.pairs) == 6
    assert len({p.second.name for p in dataset.pairs}) == 6
    pair = dataset.pairs[4]
    again = warp_image(pair.first.open(WORKING).pixels, between(pair).homography)
    assert np.array_equal(again, pair.second.open(WORKING).pixels)


def test_every_synthetic_view_is_another(tmp_path):
    for n in range(3):
        cv2.imwrite(str(tmp_path / f"{n}.png"), photograph(n))
    pairs = open_dataset(f"synthetic:{tmp_path}?count=4&seed=7").pairs
    assert [pair.second.view.seed for pair in pairs] == list(range(7, 19))
    for strength in (0.0, 0.5):
        with pytest.raises(EvalError, match="strength"):
            open_dataset(f"synthetic:{tmp_path}?strength={strength}")


def test_homography_through_four_points(rng):
    source, target = rng.uniform(0, 100, (4, 2)), rng.uniform(0, 100, (4, 2))
    q = np.column_stack([source, np.ones(4)]) @ homography_through(source, target).T
    assert q[:, :2] / q[:, 2:] == pytest.approx(target, abs=1e-6)


def write_strecha(folder, depth):
    """A wall 5 units in front of two cameras, the second one unit to the right."""
    folder.mkdir()
    for n in range(2):
        cv2.imwrite(str(folder / f"000{n}.png"), photograph(n))
        camera = f"100 0 99.5\n0 100 79.5\n0 0 1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n{n} 0 0\n{SIZE[0]} {SIZE[1]}\n"
        (folder / f"000{n}.png.camera").write_text(camera)
        if depth:
            np.save(folder / f"000{n}.depth.npy", np.full((SIZE[1], SIZE[0]), 5.0, np.float32))


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


def test_a_flat_folder_is_called_by_its_name(tmp_path, monkeypatch):
    write_strecha(tmp_path / "wall", depth=False)
    for name in "ab":
        cv2.imwrite(str(tmp_path / "wall" / f"{name}.png"), photograph(ord(name)))
    (tmp_path / "wall" / "pairs.txt").write_text(pairs_line())
    monkeypatch.chdir(tmp_path / "wall")
    for text in ("pairs:pairs.txt", f"pairs:pairs.txt?images={tmp_path / 'wall'}", "webcam:."):
        assert open_dataset(text).scenes() == ["wall"]
    for name in "ab":
        (tmp_path / "wall" / f"{name}.png").unlink()
    assert open_dataset("strecha:.").scenes() == ["wall"]
    assert open_dataset("strecha:.").pairs[0].first.name == "wall/0000.png"


def test_what_is_hidden_has_no_image():
    k, near, far = (
        np.diag([10.0, 10.0, 1.0]),
        np.full((9, 9), 2.0, np.float32),
        np.full((9, 9), 5.0, np.float32),
    )
    points = np.array([[3.0, 3.0]])
    assert through_depth(points, far, far, k, k, np.eye(4)) == pytest.approx(points)
    assert np.isnan(through_depth(points, far, near, k, k, np.eye(4))).all()
    assert np.isnan(through_depth(points, far * 0, far, k, k, np.eye(4))).all()


@pytest.mark.parametrize(("depth", "seen"), [(4.8, True), (4.7, False), (5.2, True), (5.3, False)])
def test_a_depth_five_percent_off_is_another_thing(depth, seen):
    camera = np.array([[100.0, 0, 20], [0, 100, 15], [0, 0, 1]])
    first, second = (np.full((30, 40), d, np.float32) for d in (5.0, depth))
    found = through_depth(np.array([[10.0, 10.0]]), first, second, camera, camera, np.eye(4))
    assert np.isfinite(found).all() == seen


def test_depth_is_known_on_the_map_and_above_zero_only():
    depth = np.array([[1.0, 2.0, 0.0], [4.0, -5.0, 6.0]], np.float32)
    places = [[0.4, 0.4], [2.4, 1.4], [2.0, 0.0], [1.0, 1.0], [3.0, 0.0], [0.0, 2.0], [-0.6, 0.0], [np.nan, 0.0]]
    np.testing.assert_array_equal(depth_at(depth, np.array(places)), [1.0, 6.0] + [np.nan] * 6)


def pairs_line(turns=0):
    k = "100 0 99.5 0 100 79.5 0 0 1"
    return f"a.png b.png {turns} 0 {k} {k} 1 0 0 1 0 1 0 0 0 0 1 0 0 0 0 1\n"


def test_a_list_of_posed_pairs(tmp_path):
    for name in "ab":
        cv2.imwrite(str(tmp_path / f"{name}.png"), photograph(ord(name)))
    (tmp_path / "pairs.txt").write_text(pairs_line())
    (pair,) = open_dataset(f"pairs:{tmp_path / 'pairs.txt'}").pairs
    assert between(pair).pose.translation.tolist() == [1, 0, 0]
    (tmp_path / "pairs.txt").write_text("a.png b.png 0 0\n")
    with pytest.raises(EvalError, match=r"pairs\.txt:1: expected 38 fields"):
        open_dataset(f"pairs:{tmp_path / 'pairs.txt'}")
    (tmp_path / "b.png").unlink()
    (tmp_path / "pairs.txt").write_text(pairs_line())
    with pytest.raises(EvalError, match=r"no such image.*b\.png"):
        open_dataset(f"pairs:{tmp_path / 'pairs.txt'}")


def test_quarter_turns_carry_the_camera_along(tmp_path):
    pixels = photograph(1)
    cv2.imwrite(str(tmp_path / "a.png"), pixels)
    for turns in range(4):
        image = ImageRef("a", tmp_path / "a.png", quarter_turns=turns).open(None)
        x, y = warp(image.to_working, [[30.0, 50.0]])[0]
        assert np.array_equal(image.pixels[round(y), round(x)], pixels[50, 30])


def test_an_image_is_turned_before_it_is_resized(tmp_path):
    """60x20 pixels become 20x60, and those 10x120; the top left corner comes to the bottom left."""
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((20, 60, 3), np.uint8))
    image = ImageRef("a.png", tmp_path / "a.png", quarter_turns=1).open((10, 120))
    corners = np.array([[-0.5, -0.5], [59.5, -0.5], [59.5, 19.5]])
    assert warp(image.to_working, corners) == pytest.approx(np.array([[-0.5, 119.5], [-0.5, -0.5], [9.5, -0.5]]))


@pytest.mark.parametrize("exact", [True, False])
def test_only_derived_images_are_resized_bit_exactly(photo_file, exact):
    pixels = cv2.imread(str(photo_file))
    methods = (cv2.INTER_LINEAR_EXACT, cv2.INTER_LINEAR)
    wanted, other = (cv2.resize(pixels, WORKING, interpolation=m) for m in (methods if exact else methods[::-1]))
    np.testing.assert_array_equal(ImageRef("a.png", photo_file, exact=exact).open(WORKING).pixels, wanted)
    assert (other != wanted).any()


def test_a_file_that_is_no_image_is_named(tmp_path):
    (tmp_path / "a.png").write_text("not an image")
    with pytest.raises(EvalError, match=r"a\.png"):
        _ = ImageRef("a", tmp_path / "a.png").open(None).pixels
