"""elf-detect: what it writes, what it names it, and what it says when it can't."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import onnxruntime as ort
import pytest

from elf_runtime import ElfRuntime, Features, ModelError
from elf_runtime.commands.bench_workloads import synthetic
from elf_runtime.commands.detect import main
from elf_runtime.commands.inputs import image_files
from elf_runtime.image import read
from elf_runtime.image.file import ImageFile
from helpers import ROOT, TINY, textured, turned_jpeg

MISSING = next(name for name in ort.get_all_providers() if name not in ort.get_available_providers())


def write(path: Path, seed: int = 0, size: tuple[int, int] = (96, 128)) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), synthetic(*size, seed=seed))
    return path


def results(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*.npz")}


def detect(*arguments: object) -> int:
    return main([str(a) for a in arguments] + ["--model", str(TINY), "--threads", "1"])


def test_writes_features_and_a_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, out = write(tmp_path / "photo.png"), tmp_path / "new" / "out"
    assert detect(image, "-o", out) == 0
    assert sorted(p.name for p in out.iterdir()) == ["photo.csv", "photo.npz", "photo.png"]
    found, wanted = Features.load(out / "photo.npz"), ElfRuntime(TINY).detect(image)
    np.testing.assert_array_equal(found.keypoints, wanted.keypoints)
    np.testing.assert_array_equal(found.descriptors, wanted.descriptors)
    table = np.loadtxt(out / "photo.csv", delimiter=",", skiprows=1, ndmin=2)
    np.testing.assert_allclose(table[:, :2], wanted.keypoints, atol=1e-3)
    assert cv2.imread(str(out / "photo.png")).ndim == 3
    captured = capsys.readouterr()
    assert f"{len(wanted)} keypoints, 128x96" in captured.out
    assert captured.err == ""


def test_options_reach_the_detector(tmp_path: Path) -> None:
    image, out = write(tmp_path / "a.png"), tmp_path / "out"
    options = ["--max-keypoints", 7, "--threshold", "none", "--nms-radius", 3, "--border", 12, "--scale", 0.5]
    assert detect(image, "-o", out, *options, "--descriptor", "pool1", "--no-picture") == 0
    assert sorted(p.name for p in out.iterdir()) == ["a.csv", "a.npz"]
    found = Features.load(out / "a.npz")
    settings = {"max_keypoints": 7, "threshold": "none", "nms_radius": 3, "border": 12, "scale": 0.5}
    wanted = ElfRuntime(TINY).detect(image, descriptor="pool1", **settings)
    assert len(found) == 7
    np.testing.assert_array_equal(found.keypoints, wanted.keypoints)
    np.testing.assert_array_equal(found.descriptors, wanted.descriptors)


def test_any_setting_can_be_set(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, out = write(tmp_path / "a.png"), tmp_path / "out"
    given = ["--set", "normalize=0.9", "--set", "denoise=3,0.8", "--set", "subpixel=true", "--set", "border=3"]
    assert detect(image, "-o", out, *given, "--preset", "paper", "--json", "-") == 0
    settings = {"normalize": 0.9, "denoise": (3, 0.8), "subpixel": True, "border": 3}
    elf = ElfRuntime(TINY)
    wanted = elf.detect(image, preset="paper", **settings)
    np.testing.assert_array_equal(Features.load(out / "a.npz").keypoints, wanted.keypoints)
    found = json.loads(capsys.readouterr().out)["settings"]
    assert found == json.loads(json.dumps(elf.params("paper", **settings).to_dict()))


def test_keypoints_are_in_the_turned_image_or_in_stored_pixels(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(turned_jpeg(synthetic(96, 128)))
    (tmp_path / "roi.jpg").write_bytes(turned_jpeg(np.full((96, 128), 255, np.uint8)))
    elf = ElfRuntime(TINY, threads=1)
    for more, size in (([], (128, 96)), (["--ignore-exif"], (96, 128))):
        assert detect(tmp_path / "a.jpg", "-o", tmp_path / "out", "--mask", tmp_path / "roi.jpg", *more) == 0
        found = Features.load(tmp_path / "out" / "a.npz")
        wanted = elf.detect(read(tmp_path / "a.jpg", ignore_exif=bool(more)))
        assert found.image_size == size
        np.testing.assert_array_equal(found.keypoints, wanted.keypoints)


def test_threads_and_provider_reach_the_model(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    given: dict[str, object] = {}

    def opened(model: str, **options: object) -> None:
        given.update(options, model=model)
        raise ModelError("not opened")

    monkeypatch.setattr("elf_runtime.commands.options.ElfRuntime", opened)
    arguments = [str(write(tmp_path / "a.png")), "-o", str(tmp_path / "out"), "--model", "m.onnx"]
    assert main([*arguments, "--threads", "3", "--provider", "cuda"]) == 1
    assert given == {"model": "m.onnx", "threads": 3, "providers": "cuda", "max_pixels": 100_000_000}


def test_a_mask_holds_keypoints_to_its_white_part(tmp_path: Path) -> None:
    image, out = write(tmp_path / "a.png"), tmp_path / "out"
    mask = np.zeros((96, 128, 3), np.uint8)
    mask[:, 64:] = (0, 255, 0)
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    assert detect(image, "-o", out, "--mask", tmp_path / "mask.png") == 0
    found = Features.load(out / "a.npz")
    assert len(found) > 0
    assert (found.keypoints[:, 0] >= 64).all()


def test_a_bad_image_among_good_ones(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good, other = write(tmp_path / "good.png"), write(tmp_path / "other.png", 1)
    bad, absent = tmp_path / "bad.png", tmp_path / "absent.png"
    bad.write_text("no image")
    out, summary = tmp_path / "out", tmp_path / "summary.json"
    assert detect(good, bad, absent, other, "-o", out, "--json", summary) == 1
    assert {p.name for p in out.glob("*.npz")} == {"good.npz", "other.npz"}
    assert not list(out.glob("bad*")) + list(out.glob("absent*"))
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 2
    assert all(line.startswith("elf-detect: error: ") for line in errors)
    assert str(bad) in errors[0]
    assert str(absent) in errors[1]
    images = json.loads(summary.read_text())["images"]
    assert ["error" in entry for entry in images] == [False, True, True, False]
    assert [entry["error"] for entry in images[1:3]] == [line.partition("error: ")[2] for line in errors]
    assert images[0]["keypoints"] == len(Features.load(out / "good.npz"))


def test_a_folder_is_made_only_for_what_goes_into_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small = write(tmp_path / "small.png", size=(8, 8))
    assert detect(small, "-o", tmp_path / "new") == 1
    assert f"{small}: the image has 8x8 pixels" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
    assert detect(small, "-o", tmp_path / "new", "--json", tmp_path / "new" / "summary.json") == 1
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["summary.json"]


def test_the_stages_hold_the_time_that_decoding_takes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def slowly(*given: object) -> np.ndarray:
        time.sleep(0.05)
        return decoded(*given)

    decoded = ImageFile.decoded
    monkeypatch.setattr(ImageFile, "decoded", slowly)
    assert detect(write(tmp_path / "a.png"), "-o", tmp_path / "out", "--json", tmp_path / "s.json") == 0
    (summary,) = json.loads((tmp_path / "s.json").read_text())["images"]
    assert 0.05 <= summary["stages"]["read"] <= summary["seconds"]


def test_a_summary_on_standard_output_is_alone_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert detect(write(tmp_path / "a.png"), "-o", tmp_path / "out", "--json", "-", "--preset", "paper") == 0
    captured = capsys.readouterr()
    summary = json.loads(captured.out)
    assert summary["settings"]["quantize"] is True
    assert summary["descriptor"] == "relu2"
    assert "keypoints" in captured.err


def test_the_summary_s_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = write(tmp_path / "a.png")
    assert detect(image, "-o", tmp_path / "out", "--scale", 0.5, "--border", 3, "--json", "-") == 0
    summary = json.loads(capsys.readouterr().out)
    trace = ElfRuntime(TINY, threads=1).trace(image, scale=0.5, border=3)
    assert (summary["settings"]["scale"], summary["settings"]["border"]) == (0.5, 3)
    assert summary["images"][0]["passed"] == pytest.approx(trace.mask.mean())
    assert 0.0 < summary["images"][0]["passed"] < 1.0


def test_standard_output_is_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "-").mkdir()
    image = write(tmp_path / "a.png")
    monkeypatch.chdir(tmp_path)
    assert detect(image, "-o", "out", "--json", "-") == 0


def test_folders_patterns_and_repeated_files(tmp_path: Path) -> None:
    a, b = write(tmp_path / "in" / "a.png"), write(tmp_path / "in" / "b.JPG")
    (tmp_path / "in" / "notes.txt").write_text("no image")
    (tmp_path / "in" / "folder.png").mkdir()
    assert list(image_files([str(tmp_path / "in")])) == [a, b]
    assert list(image_files([str(tmp_path / "in" / "*.png"), str(a)])) == [a]
    assert list(image_files([str(b), str(tmp_path / "in")])) == [b, a]


def test_subfolders_are_looked_into_where_that_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = write(tmp_path / "in" / "x" / "1.png"), write(tmp_path / "in" / "y" / "z" / "1.png", 1)
    assert detect(tmp_path / "in", "-o", tmp_path / "out") == 2
    assert "in this folder; --recursive looks below it too" in capsys.readouterr().err
    assert list(image_files([str(tmp_path / "in")], recursive=True)) == [first, second]
    assert detect(tmp_path / "in", "-r", "-o", tmp_path / "out", "--no-picture") == 0
    assert results(tmp_path / "out") == {"x/1.npz", "y/z/1.npz"}
    (tmp_path / "empty").mkdir()
    assert detect(tmp_path / "empty", "-r", "-o", tmp_path / "out") == 2
    assert "in this folder or below it\n" in capsys.readouterr().err


def test_hidden_files_of_a_folder_are_no_images(tmp_path: Path) -> None:
    shown = write(tmp_path / ".home" / "in" / "1.png")
    for hidden in ("._1.png", ".cache/2.png", "x/.3.png"):
        write(shown.parent / hidden)
    assert list(image_files([str(shown.parent)], recursive=True)) == list(image_files([str(shown.parent)])) == [shown]


@pytest.mark.parametrize(
    ("arguments", "base", "names"),
    [
        (["x/1.png", "2.png"], None, ["x/1", "2"]),
        (["a/1.png", "b/1.png"], None, ["a/1", "b/1"]),
        (["./a/1.png", "a/../b/1.png"], None, ["a/1", "a/b/1"]),
        (["a", "b"], None, ["a/1", "b/1"]),
        (["."], None, ["2", "a/1", "b/1", "x/1"]),
        (["a", "x/1.png"], "a/..", ["a/1", "x/1"]),
        (["ROOT/a/1.png"], None, ["1"]),
        (["ROOT/a", "ROOT/2.png"], None, ["1", "2"]),
        (["ROOT"], None, ["2", "a/1", "b/1", "x/1"]),
        (["ROOT/a", "ROOT/b"], "ROOT", ["a/1", "b/1"]),
        (["*/1.png"], None, ["a/1", "b/1", "x/1"]),
    ],
)
def test_a_name_depends_on_its_own_argument_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], base: str | None, names: list[str]
) -> None:
    for path in ("a/1.png", "b/1.png", "x/1.png", "2.png"):
        write(tmp_path / path)
    monkeypatch.chdir(tmp_path)
    given = [argument.replace("ROOT", str(tmp_path)) for argument in arguments]
    start = Path(base.replace("ROOT", str(tmp_path))) if base else None
    assert [str(name) for name in image_files(given, recursive=True, base=start).values()] == names
    for argument in given:
        alone = image_files([argument], recursive=True, base=start)
        assert {str(name) for name in alone.values()} <= set(names)


def test_results_of_another_image_are_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = write(tmp_path / "a" / "1.png"), write(tmp_path / "b" / "1.png", 1)
    monkeypatch.chdir(first.parent)
    assert detect("1.png", "-o", "../out") == 0
    kept = {path: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    monkeypatch.chdir(second.parent)
    for options in ([], ["--skip-existing"], ["--no-picture"]):
        assert detect("1.png", "-o", "../out", *options) == 1
        assert f"1.npz holds the results of {first}; give another -o" in capsys.readouterr().err
        assert {path: path.read_bytes() for path in (tmp_path / "out").iterdir()} == kept
    assert detect("1.png", "-o", "../out", "--overwrite") == 0
    assert {path: path.read_bytes() for path in (tmp_path / "out").iterdir()} != kept


def test_two_images_of_one_name_in_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = write(tmp_path / "a" / "1.png"), write(tmp_path / "b" / "1.png", 1)
    for options in ([], ["--overwrite"]):
        assert detect(first, second, "-o", tmp_path / "out", "--no-picture", *options) == 1
        assert f"error: {second}: {tmp_path}/out/1.npz holds the results of {first}" in capsys.readouterr().err
        assert len(Features.load(tmp_path / "out" / "1.npz")) > 0
    assert detect(first, second, "-o", tmp_path / "both", "--no-picture", "--base", tmp_path) == 0
    assert results(tmp_path / "both") == {"a/1.npz", "b/1.npz"}


def test_images_that_differ_in_their_ending_only(tmp_path: Path) -> None:
    """Their names are the same whichever of them are in the run, and a picture of ours is no image."""
    first, second = write(tmp_path / "in" / "1.png"), write(tmp_path / "in" / "1.jpg", 1)
    write(tmp_path / "in" / "2.jpg")
    wanted = {"1.jpg.npz", "1.png.npz", "2.npz"}
    assert detect(tmp_path / "in", "-o", tmp_path / "out", "--no-picture") == 0
    assert results(tmp_path / "out") == wanted
    for image in (first, second):
        assert detect(image, "-o", tmp_path / "again", "--no-picture") == 0
    assert results(tmp_path / "again") == wanted - {"2.npz"}
    beside = write(tmp_path / "beside" / "3.jpg")
    for _ in range(2):
        assert detect(beside, "-o", tmp_path / "beside") == 0
        assert results(tmp_path / "beside") == {"3.npz"}


def test_a_link_and_its_file_are_two_images(tmp_path: Path) -> None:
    image = write(tmp_path / "in" / "z.jpg")
    (tmp_path / "in" / "a.jpg").symlink_to("z.jpg")
    assert detect(tmp_path / "in", image, "-o", tmp_path / "out", "--no-picture") == 0
    assert results(tmp_path / "out") == {"a.npz", "z.npz"}


def test_an_image_that_fails_takes_no_name(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "q.png").write_bytes(b"GIF89a")
    good = write(tmp_path / "b" / "q.png")
    assert detect(tmp_path / "a" / "q.png", good, "-o", tmp_path / "out", "--no-picture") == 1
    assert results(tmp_path / "out") == {"q.npz"}


def test_pictures_beside_their_images_are_no_images_of_the_folder(tmp_path: Path) -> None:
    image = write(tmp_path / "in" / "x.jpg")
    assert detect(image, "-o", image.parent) == 0
    for options in ([], ["--no-picture"]):
        out = tmp_path / f"out{len(options)}"
        assert detect(image.parent, "-o", out, *options) == 0
        assert results(out) == {"x.npz"}
    own = write(tmp_path / "own" / "y.png")
    for _ in range(2):  # its own features beside it do not make it a picture of ours
        assert detect(own, "-o", own.parent, "--no-picture") == 0
        assert detect(own.parent, "-o", tmp_path / "out") == 0
    assert "y.npz" in results(tmp_path / "out")


def test_skipping_and_overwriting_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, out = write(tmp_path / "1.jpg"), tmp_path / "out"
    for said in (" keypoints", ": skipped, "):
        assert detect(image, "-o", out, "--skip-existing", "--overwrite") == 0
        assert said in capsys.readouterr().out


def test_a_file_of_somebody_else_s_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = write(tmp_path / "1.jpg")
    for name in ("1.npz", "1.csv", "1.png"):
        out = tmp_path / f"out-{name}"
        out.mkdir()
        (out / name).write_text("precious")
        assert detect(image, "-o", out) == 1
        assert f"{name} is no result of elf-detect" in capsys.readouterr().err
        assert [path.read_text() for path in out.iterdir()] == ["precious"]


def test_what_is_done_is_skipped(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, out = write(tmp_path / "1.jpg"), tmp_path / "out"

    def ran(*options: object) -> bool:
        before = (out / "1.npz").stat().st_mtime_ns if out.exists() else 0
        assert detect(image, "-o", out, "--skip-existing", *options) == 0
        again = (out / "1.npz").stat().st_mtime_ns != before
        assert (": skipped, " in capsys.readouterr().out) is not again
        return again

    assert ran()
    assert not ran()
    assert ran("--max-keypoints", 7)
    assert not ran("--max-keypoints", 7)
    cv2.imwrite(str(tmp_path / "mask.png"), np.full((96, 128), 255, np.uint8))
    assert ran("--max-keypoints", 7, "--mask", tmp_path / "mask.png")
    assert not ran("--max-keypoints", 7, "--mask", tmp_path / "mask.png")
    (out / "1.csv").unlink()
    assert ran("--max-keypoints", 7, "--mask", tmp_path / "mask.png")
    write(image, 1)
    assert ran("--max-keypoints", 7, "--mask", tmp_path / "mask.png")
    summary = tmp_path / "s.json"
    assert not ran("--max-keypoints", 7, "--mask", tmp_path / "mask.png", "--json", summary)
    assert json.loads(summary.read_text())["images"][0]["skipped"] is True


def test_fewer_than_asked_for_says_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = write(tmp_path / "1.jpg")
    assert detect(image, "-o", tmp_path / "out", "--max-keypoints", 2000) == 0
    said = "keypoints of 2000 asked for: the threshold (--threshold) let through no more, 128x96"
    assert said in capsys.readouterr().out
    assert detect(image, "-o", tmp_path / "out", "--set", "max_keypoints=2000") == 0
    assert said in capsys.readouterr().out
    assert detect(image, "-o", tmp_path / "out", "--max-keypoints", 2000, "--threshold", "none") == 0
    assert "keypoints of 2000 asked for: there are no more, 128x96" in capsys.readouterr().out
    for options in (["--max-keypoints", 2], []):
        assert detect(image, "-o", tmp_path / "out", *options) == 0
        assert "asked for" not in capsys.readouterr().out


def test_an_interrupted_image_is_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image, out = write(tmp_path / "1.jpg"), tmp_path / "out"
    assert detect(image, "-o", out, "--max-keypoints", 3) == 0
    monkeypatch.setattr("elf_runtime.commands.detect.detection_picture", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        detect(image, "-o", out)
    monkeypatch.undo()
    assert not (out / "1.png").exists()  # it was of other settings
    assert detect(image, "-o", out, "--skip-existing") == 0
    assert len((out / "1.csv").read_text().splitlines()) == len(Features.load(out / "1.npz")) + 1 > 4
    assert (out / "1.png").exists()


NAMES = [b"not\xff\xfeutf.png", "bl\u00e4tter \u6c34.png".encode(), b"tab\tand\nline\x1b[31m.png", b"x" * 200 + b".png"]


@pytest.mark.skipif(os.name == "nt", reason="names are Unicode there")
@pytest.mark.parametrize("encoding", ["ascii", "utf-8", "latin-1"])
def test_any_name_on_any_terminal(tmp_path: Path, encoding: str) -> None:
    image = write(tmp_path / "1.png").read_bytes()
    for name in NAMES:
        (tmp_path / "in" / os.fsdecode(name)).parent.mkdir(exist_ok=True)
        (tmp_path / "in" / os.fsdecode(name)).write_bytes(image)
    env = {**os.environ, "PYTHONIOENCODING": encoding, "PYTHONPATH": str(ROOT / "runtime")}
    for module, arguments in (
        ("detect", ["in", "-o", "out", "--json", "s.json"]),
        ("match", [f"in/{os.fsdecode(NAMES[0])}", f"in/{os.fsdecode(NAMES[1])}", "-o", "m.png"]),
        ("detect", ["in/absent\udcff\x1b31m.png", "-o", "out"]),
    ):
        command = [sys.executable, "-m", f"elf_runtime.commands.{module}", *arguments, "--model", str(TINY)]
        done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, check=False)
        said = done.stdout + done.stderr
        assert b"Traceback" not in said, said.decode(errors="replace")
        assert done.returncode == int("absent" in arguments[0])
        assert b"\x1b" not in said
        assert said.count(b"\n") == {"in": 4}.get(arguments[0], 1)
    assert len(results(tmp_path / "out")) == 4
    assert len(json.loads((tmp_path / "s.json").read_text())["images"]) == 4


def test_a_loop_of_links_is_an_error_of_its_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "loop.png").symlink_to(tmp_path / "loop.png")
    assert detect(tmp_path / "loop.png", write(tmp_path / "1.png"), "-o", tmp_path / "out", "--no-picture") == 1
    assert "loop.png: Too many levels of symbolic links" in capsys.readouterr().err
    assert results(tmp_path / "out") == {"1.npz"}


def test_an_input_image_is_never_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = write(tmp_path / "a.png")
    before = image.read_bytes()
    assert detect(image, "-o", tmp_path) == 2
    assert "is an input image" in capsys.readouterr().err
    assert image.read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["in", "-o", "in"], "-o in: the pictures would be taken for images of the folder in next time"),
        (["in", "-o", "in/../in"], "for images of the folder in"),
        (["-r", ".", "-o", "in/new"], "for images of the folder ."),
        (["in/*.png", "-o", "in"], "in/b.png is a picture that elf-detect wrote"),
        (["in/b.png", "-o", "elsewhere"], "in/b.png is a picture that elf-detect wrote"),
    ],
)
def test_pictures_are_not_written_where_images_are_taken_from(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    reason: str,
) -> None:
    write(tmp_path / "in" / "b.jpg")
    monkeypatch.chdir(tmp_path)
    if "b.png" in reason:
        assert detect("in/b.jpg", "-o", ".") == 0
    before = sorted(tmp_path.rglob("*"))
    capsys.readouterr()
    assert detect(*arguments) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert reason in error
    assert "or --no-picture" in error
    assert sorted(tmp_path.rglob("*")) == before
    assert detect(*arguments, "--no-picture") == 0


def test_results_may_lie_beside_the_images(tmp_path: Path) -> None:
    image = write(tmp_path / "a.jpg")
    for _ in range(2):
        assert detect(image, "-o", tmp_path) == 0
        assert sorted(p.name for p in tmp_path.iterdir()) == ["a.csv", "a.jpg", "a.npz", "a.png"]


def test_a_hard_link_to_an_input_is_not_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, out = write(tmp_path / "in" / "a.png"), tmp_path / "out"
    out.mkdir()
    os.link(image, out / "a.png")
    before = image.read_bytes()
    assert detect(image, "-o", out) == 2
    assert "is an input image" in capsys.readouterr().err
    assert image.read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "status", "reason"),
    [
        (["p.png", "-o", ".", "--mask", "m/p.png", "--no-picture", "--json", "m/p.png"], 2, "m/p.png is the mask"),
        (["q.jpg", "-o", "m", "--mask", "m/q.png"], 2, "-o: m/q.png is the mask"),
        (["q.jpg", "-o", "m", "--mask", "link.png"], 2, "-o: m/q.png is the mask"),
        (["p.png", "-o", "out", "--json", "p.png"], 2, "--json: p.png is an input image"),
        (["m/p.png", "p.png", "-o", "out", "--json", "./p.png"], 2, "--json: p.png is an input image"),
        (["q.jpg", "-o", "out", "--json", "out/q.png"], 2, "--json: out/q.png is an output of -o"),
        (["p.jpg", "-o", "out", "--json", "out/p.jpg.png"], 2, "--json: out/p.jpg.png is an output of -o"),
        (["p.jpg", "-o", "out", "--json", "model.onnx"], 2, "--json: model.onnx is the model"),
        (["p.jpg", "-o", "out", "--json", "nodir/x.json"], 1, "--json: there is no folder nodir"),
        (["p.jpg", "-o", "out", "--json", "p.png/x.json"], 1, "--json: p.png is not a folder"),
        (["p.jpg", "-o", "out", "--json", "m"], 1, "--json: m exists and is not a file"),
        (["p.jpg", "-o", "p.png"], 1, "-o: p.png is not a folder"),
        (["p.jpg", "-o", "p.png/out"], 1, "-o: "),
    ],
)
def test_outputs_are_checked_before_the_work(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    status: int,
    reason: str,
) -> None:
    for seed, name in enumerate(("p.png", "p.jpg", "q.jpg", "m/p.png", "m/q.png")):
        write(tmp_path / name, seed)
    (tmp_path / "link.png").symlink_to("m/q.png")
    (tmp_path / "model.onnx").write_bytes(TINY.read_bytes())
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ElfRuntime, "trace", None)  # no image gets that far
    assert main([*arguments, "--model", "model.onnx", "--threads", "1"]) == status
    error = capsys.readouterr().err
    assert error.startswith("elf-detect: error: ")
    assert error.count("\n") == 1
    assert reason in error
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_summary_may_lie_in_the_folder_that_is_made(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    for summary in (out / "summary.json", tmp_path / "new" / "summary.json"):
        assert detect(write(tmp_path / "a.png"), "-o", out, "--json", summary) == 0
        assert json.loads(summary.read_text())["images"]
    assert detect(tmp_path / "a.png", "-o", out, "--json", out / "summary.json") == 0  # written again


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_is_read_only(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, out = write(tmp_path / "a.png"), tmp_path / "out"
    out.mkdir(mode=0o500)
    assert detect(image, "-o", out) == 1
    assert "nothing can be written into the folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "status", "reason"),
    [
        (["--threshold", "2"], 2, "threshold"),
        (["--nms-radius", "-1"], 2, "nms_radius"),
        (["--scale", "0"], 2, "scale"),
        (["--descriptor", "pool9"], 2, "no descriptor layer 'pool9'"),
        (["--provider", MISSING], 1, "Install the build that has it, or take one of these"),
        (["--provider", "quantum"], 1, "unknown provider 'quantum'"),
        (["--mask", "absent.png"], 1, "absent.png"),
        (["--set", "sale=1"], 2, "--set: unknown setting 'sale'; known are denoise, threshold_blur, threshold, nms_"),
        (["--set", "mask=1"], 2, "--set: unknown setting 'mask'"),
        (["--set", "preset=fast"], 2, "--set: unknown setting 'preset'"),
        (["--set", "scale=0.5", "--scale", "0.4"], 2, "--set scale: --scale is given too"),
        (["--set", "normalize=2"], 2, "normalize is a quantile in (0, 1], not 2"),
        (["--set", "subpixel=maybe"], 2, "subpixel is True or False, not 'maybe'"),
    ],
)
def test_one_line_for_what_is_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], status: int, reason: str
) -> None:
    assert detect(write(tmp_path / "a.png"), "-o", tmp_path / "out", *arguments) == status
    error = capsys.readouterr().err
    assert error.startswith("elf-detect: error: ")
    assert error.count("\n") == 1
    assert reason in error


@pytest.mark.parametrize("content", [b"", b"text", TINY.read_bytes()[:6000]])
def test_a_file_that_is_no_model(tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes) -> None:
    model = tmp_path / "model.onnx"
    model.write_bytes(content)
    image = write(tmp_path / "a.png")
    assert main([str(image), "-o", str(tmp_path / "out"), "--model", str(model)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert str(model) in error
    assert not (tmp_path / "out").exists()


def test_an_empty_folder_and_an_empty_pattern_are_usage_errors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert detect(tmp_path, "-o", tmp_path / "out") == 2
    assert "no images" in capsys.readouterr().err
    assert detect(tmp_path / "*.png", "-o", tmp_path / "out") == 2
    assert "no file matches" in capsys.readouterr().err


def test_a_flat_image_has_no_keypoints_and_a_picture(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "flat.png"), np.full((64, 64), 90, np.uint8))
    assert detect(tmp_path / "flat.png", "-o", tmp_path / "out") == 0
    assert len(Features.load(tmp_path / "out" / "flat.npz")) == 0
    assert (tmp_path / "out" / "flat.png").exists()


def test_no_part_of_a_file_is_left_where_writing_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    image, out = write(tmp_path / "a.png"), tmp_path / "out"
    monkeypatch.setattr("elf_runtime.files.write.os.replace", full)
    assert detect(image, "-o", out) == 1
    assert "No space left" in capsys.readouterr().err
    assert not list(out.glob("*.png"))
    assert not [p for p in out.iterdir() if p.suffix == ".png" or ".part.png" in p.name]


def test_an_interruption_has_the_shell_s_status(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("elf_runtime.commands.detect.image_files", interrupted)
    assert detect("a.png", "-o", tmp_path) == 130


def test_max_pixels_raises_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), textured(48, 64))
    monkeypatch.setitem(ElfRuntime.__init__.__kwdefaults__, "max_pixels", 1000)  # the default
    words = [str(tmp_path / "a.png"), "-o", str(tmp_path / "out"), "--model", str(TINY), "--no-picture"]
    assert main([*words, "--max-pixels", "5000"]) == 0


@pytest.mark.parametrize("text", ["ax6", "2,3", "0x3", "4x", "4x6x2"])
def test_a_grid_that_is_none_is_refused(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["a.png", "-o", "out", "--grid", text])
    assert capsys.readouterr().err.endswith(f"argument --grid: {text!r} is not ROWSxCOLUMNS\n")


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--threshold", "1,2"], "threshold is 'kapur', 'none' or a number in [0, 1], not 1,2"),
        (["--set", "grid=4,0"], "grid is (rows, columns), integers >= 1, not 4,0"),
        (["--set", "denoise=4,1.5"], "denoise is (mu, sigma) with mu odd, 1 to 999, and sigma > 0, not 4,1.5"),
    ],
)
def test_a_setting_s_error_shows_what_was_typed(
    words: list[str], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), textured(48, 64))
    assert main([str(tmp_path / "a.png"), "-o", str(tmp_path / "out"), "--model", str(TINY), *words]) == 2
    assert capsys.readouterr().err == f"elf-detect: error: {reason}\n"
