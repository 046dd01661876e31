"""elf-detect: the features, the picture and the summary that it writes, and the settings that reach the detector."""

from __future__ import annotations

import json
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime import ElfRuntime, Features, ModelError
from elf_runtime.commands.bench_workloads import synthetic
from elf_runtime.commands.detect import main
from elf_runtime.image import read
from elf_runtime.image.file import ImageFile
from helpers import TINY, textured, turned_jpeg
from runtime.commands.detecting import detect, write


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


def test_scales_in_files_and_record(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, out = write(tmp_path / "a.png"), tmp_path / "out"
    assert detect(image, "-o", out, "--set", "scales=0.5,1", "--set", "threshold=none", "--json", "-") == 0
    wanted = ElfRuntime(TINY).detect(image, scales=(1.0, 0.5), threshold="none")
    assert len(set(wanted.sizes.tolist())) == 2
    np.testing.assert_array_equal(Features.load(out / "a.npz").sizes, wanted.sizes)
    table = np.loadtxt(out / "a.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[:, 3], wanted.sizes, atol=1e-3)
    assert json.loads(capsys.readouterr().out)["settings"]["scales"] == [0.5, 1.0]
    assert detect(image, "-o", out, "--preset", "multiscale", "--scale", 0.5, "--overwrite", "--json", "-") == 0
    found = json.loads(capsys.readouterr().out)["settings"]
    assert (found["scale"], found["scales"]) == (0.5, [])
    assert detect(image, "-o", out, "--set", "scales=0.5,0.5") == 2


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


def test_a_flat_image_has_no_keypoints_and_a_picture(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "flat.png"), np.full((64, 64), 90, np.uint8))
    assert detect(tmp_path / "flat.png", "-o", tmp_path / "out") == 0
    assert len(Features.load(tmp_path / "out" / "flat.npz")) == 0
    assert (tmp_path / "out" / "flat.png").exists()


def test_max_pixels_raises_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), textured(48, 64))
    monkeypatch.setitem(ElfRuntime.__init__.__kwdefaults__, "max_pixels", 1000)  # the default
    words = [str(tmp_path / "a.png"), "-o", str(tmp_path / "out"), "--model", str(TINY), "--no-picture"]
    assert main([*words, "--max-pixels", "5000"]) == 0
