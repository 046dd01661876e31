"""`elf-eval sfm` and the dataset of COLMAP's models, on a rendered room whose cameras are known."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import error_of

from elf_eval.cli import main
from elf_eval.data import open_dataset
from elf_eval.errors import EvalError
from elf_eval.metrics.pose import pose_error
from elf_eval.run.results import Results
from elf_eval.run.subsets import draw_subsets
from elf_runtime.reconstruction import map_database
from room import SIZE, K, views, write_as_strecha

pytest.importorskip("pycolmap", reason="pycolmap, of the extra sfm, is not installed")

COUNT = 6  # of the room's views


@pytest.fixture(scope="module")
def room_folder(tmp_path_factory) -> Path:
    """Views of the room as Strecha's scenes are published."""
    scene = tmp_path_factory.mktemp("strecha") / "room"
    write_as_strecha(scene, views()[:COUNT])
    return scene


@pytest.fixture(scope="module")
def found(room_folder, tmp_path_factory) -> tuple[Path, list[dict]]:
    out = tmp_path_factory.mktemp("out")
    command = ["sfm", "--dataset", f"room=strecha:{room_folder}", "--detector", "sift?ratio=0.8"]
    rest = ["--sizes", "3,5,10", "--subsets", "2", "--out", str(out), "--cache", str(out / "c"), "--quiet"]
    assert main([*command, *rest, "--max-keypoints", "512", "--threads", "1"]) == 0
    return out, json.loads((out / "sfm.json").read_text())


def test_few_images_are_placed_where_they_were(found):
    out, studied = found
    assert [each["size"] for each in studied] == [3, 5]
    for each in studied:
        assert len(each["subsets"]) == 2
        for one in each["subsets"]:
            assert one["placed"] == each["size"]
            assert len(one["errors"]) == each["size"] * (each["size"] - 1) // 2
            assert max(one["errors"]) < 2.0  # degrees
            assert len(one["keypoints"]) == each["size"]
            assert all(0 < count <= 512 for count in one["keypoints"])
    page = (out / "sfm.md").read_text()
    assert "Not measured: 10 images of room/room" in page
    assert "100.0 / 100.0 / 100.0 / 100.0 / 100.0" in page
    counts = {n for size in studied for one in size["subsets"] for n in one["keypoints"]}
    cells = re.findall(r"\| sift\?ratio=0\.8 \| (\d+) \((\d+)\) \|", page)
    assert len(cells) == 2
    assert min(int(least) for _, least in cells) == min(counts)
    assert all(min(counts) <= int(mean) <= max(counts) for mean, _ in cells)


@pytest.mark.parametrize("option", [["--counts", "equal"], ["--count-floor", "9"], ["--eps", "3"], ["--refine"]])
def test_options_of_scores_are_none_of_its_own(option, tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["sfm", "--dataset", f"strecha:{tmp_path}", "--detector", "sift", "--out", str(tmp_path), *option])
    assert f"unrecognized arguments: {option[0]}" in capsys.readouterr().err


def test_refined_matches_are_refused_before_the_work(room_folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("elf_eval.run.runner._extract", lambda *_, **__: pytest.fail("worked"))
    command = ["sfm", "--dataset", f"room=strecha:{room_folder}", "--detector", "sift?refine=true", "--sizes", "3"]
    (line,) = error_of([*command, "--out", str(tmp_path), "--cache", str(tmp_path / "c"), "--quiet"], capsys)
    assert line.startswith("method 'sift?refine=true': refine=true moves the points of a pair's matches")


def test_images_that_are_not_placed_are_failures(room_folder, tmp_path):
    """With 8 keypoints nothing fits a geometry."""
    command = ["sfm", "--dataset", f"room=strecha:{room_folder}", "--detector", "orb", "--max-keypoints", "8"]
    rest = ["--sizes", "3", "--subsets", "1", "--out", str(tmp_path), "--cache", str(tmp_path / "c"), "--quiet"]
    assert main([*command, *rest, "--threads", "1"]) == 0
    (studied,) = json.loads((tmp_path / "sfm.json").read_text())
    (one,) = studied["subsets"]
    assert (one["placed"], one["errors"]) == (0, [None] * 3)
    assert "0.0 / 0.0 / 0.0 / 0.0 / 0.0" in (tmp_path / "sfm.md").read_text()


def test_the_mapper_is_on_one_thread_whatever_the_command_has(room_folder, tmp_path, monkeypatch):
    """On several, the pair that it begins with is another one from run to run."""
    threads = []

    def mapper(*args, **options):
        threads.append(options["threads"])
        return map_database(*args, **options)

    monkeypatch.setattr("elf_eval.run.sfm.map_database", mapper)
    command = ["sfm", "--dataset", f"room=strecha:{room_folder}", "--detector", "orb", "--sizes", "3", "--threads", "2"]
    rest = ["--subsets", "2", "--out", str(tmp_path), "--cache", str(tmp_path / "c"), "--quiet"]
    assert main([*command, *rest]) == 0
    assert threads == [1, 1]


def test_subsets_hang_together_and_are_the_same_again(room_folder):
    pairs = open_dataset(f"strecha:{room_folder}?step=1").pairs
    drawn = draw_subsets(pairs, 3, 4, 0)
    assert drawn == draw_subsets(pairs, 3, 4, 0)
    assert len(set(drawn)) == 4
    for subset in drawn:
        numbers = [int(Path(ref.name).stem) for ref in subset]
        assert numbers == list(range(numbers[0], numbers[0] + 3))
    assert len(draw_subsets(pairs, COUNT, 4, 0)) == 1
    assert draw_subsets(pairs, COUNT + 1, 4, 0) == []


def test_a_dataset_without_poses_is_refused(hpatches_folder, tmp_path, capsys):
    command = ["sfm", "--dataset", f"d=hpatches:{hpatches_folder}", "--detector", "sift", "--out", str(tmp_path)]
    (line,) = error_of(command, capsys)
    assert line.startswith("d: i_light/1.png - i_light/2.png: structure from motion needs pairs whose poses are known")


@pytest.fixture(scope="module")
def colmap_folder(room_folder, tmp_path_factory) -> Path:
    """The same scene with a model of COLMAP's, of all its images."""
    from elf_runtime import Features, match
    from elf_runtime.reconstruction import Calibration, exhaustive, map_database, shared_cameras, write_database

    scene = tmp_path_factory.mktemp("colmap") / "room"
    (scene / "sparse").mkdir(parents=True)
    (scene / "images").symlink_to(room_folder / "images")
    sift, images = cv2.SIFT_create(1500), {}
    for path in sorted((scene / "images").iterdir()):
        points, descriptors = sift.detectAndCompute(cv2.imread(str(path)), None)
        order = np.argsort([-p.response for p in points], kind="stable")
        rows = descriptors[order] / np.linalg.norm(descriptors[order], axis=1, keepdims=True)
        where = np.array([p.pt for p in points], np.float32)[order]
        images[path.name] = Features(where, np.arange(len(order), 0, -1, np.float32), rows, SIZE, 1.0)
    cameras = shared_cameras(dict.fromkeys(images, SIZE), calibration=Calibration.of_matrix(K))
    pairs = {(a, b): match(images[a], images[b], 0.8) for a, b in exhaustive(list(images))}
    write_database(scene / "database.db", images, pairs, cameras)
    map_database(scene / "database.db", scene / "images", scene / "sparse", refine=False, threads=1)
    return scene


def test_a_model_of_colmap_s_gives_the_same_truth(colmap_folder, room_folder):
    true = {pair.name: pair for pair in open_dataset(f"strecha:{room_folder}").pairs}
    pairs = open_dataset(f"colmap:{colmap_folder}?shared=50").pairs
    assert len(pairs) >= COUNT
    for pair in pairs:
        a, b = (p.truth.at(np.eye(3), np.eye(3)).pose for p in (pair, true[pair.name]))
        assert pose_error((a.rotation, a.translation), b.rotation, b.translation) < 0.5
        assert np.allclose(a.camera1, K)
    assert len(open_dataset(f"colmap:{colmap_folder}?shared=50&step=1").pairs) == COUNT - 1


def test_a_model_without_a_pair_is_named(colmap_folder):
    few = f"of its {COUNT} images no two at most 1 apart show 99999 of the same points"
    with pytest.raises(EvalError, match=few):
        open_dataset(f"colmap:{colmap_folder}?shared=99999&step=1")
    incomplete = {}
    with pytest.raises(EvalError, match="no pairs found"):
        open_dataset(f"colmap:{colmap_folder}?shared=99999&step=1", incomplete)
    assert few in incomplete[colmap_folder.name]


def test_wide_stereo_by_the_suite(colmap_folder, tmp_path, monkeypatch):
    """The suite on it: mAP of poses, and ms where there are depth maps, in COLMAP's files."""
    suite = Path(__file__).parents[3] / "evaluation" / "suites" / "paper_image_matching.toml"
    monkeypatch.setenv("ELF_IMAGE_MATCHING", f"colmap:{colmap_folder}?step=1")
    maps = colmap_folder / "stereo" / "depth_maps"
    maps.mkdir(parents=True, exist_ok=True)
    for n in range(2):
        values = np.full(SIZE, 4.0, "<f4")
        (maps / f"000{n}.png.geometric.bin").write_bytes(f"{SIZE[1]}&{SIZE[0]}&1&".encode() + values.tobytes())
    rest = ["--out", str(tmp_path), "--cache", str(tmp_path / "c"), "--quiet", "--threads", "1"]
    assert main(["run", str(suite), *rest]) == 0
    results = Results.load(tmp_path / "paper_image_matching" / "results.json")
    assert results.protocol["max_keypoints"] == 512
    pairs = results.of("wide stereo", "SIFT", "own")
    assert [pair.second for pair in pairs if "ms" in pair.metrics] == ["room/0001.png"]
    assert all(pair.metrics["pose_right@10"] == 1.0 for pair in pairs)
    page = (tmp_path / "paper_image_matching" / "README.md").read_text()
    assert "pose mAP@5 / 10 / 15 / 20 / 25" in page
    assert "The paper's own figures of this challenge were published as a picture" in page
    assert "the paper's HPatches" not in page
    (maps / "0000.png.geometric.bin").write_bytes(b"7&5&1&")
    with pytest.raises(Exception, match=r"a depth map of 7x5 for 0000.png of 640x480 pixels"):
        open_dataset(f"colmap:{colmap_folder}")
