"""elf-bench: it runs, reports what it should, and pairs what it times.  No time is ever asserted."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime import ElfError, ElfRuntime
from elf_runtime.commands.bench import _open, build_parser, main, sizes
from elf_runtime.commands.bench_table import _size_rows
from elf_runtime.commands.bench_workloads import Workload, synthetic
from elf_runtime.timing import fresh_process
from elf_runtime.timing.fresh_process import peak_memory, start_up
from elf_runtime.timing.interleave import interleaved, with_sums
from helpers import ROOT, TINY

STAGES = ("read", "prepare", "session", "blur", "threshold", "nms", "descriptors")
SUMS = ("post-processing", "detect + describe")


def bench(*arguments: object) -> int:
    quick = ["--repeats", "3", "--warmup", "1", "--processes", "1", "--threads", "1"]
    return main([str(a) for a in arguments] + ["--model", str(TINY), *quick])


def test_reports_every_stage_and_peer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    threads = cv2.getNumThreads()
    assert bench("--sizes", "64x96,80x64", "--peers", "sift,orb", "--json", tmp_path / "b.json") == 0
    assert cv2.getNumThreads() == threads
    report = json.loads((tmp_path / "b.json").read_text())
    assert [(e["height"], e["width"]) for e in report["sizes"]] == [(64, 96), (80, 64)]
    assert report["environment"]["threads"] == 1
    assert report["start_up"]["import_s"] > 0
    for entry in report["sizes"]:
        assert {f"elf.{stage}" for stage in (*STAGES, *SUMS)} <= set(entry["seconds"])
        assert {"elf", "elf_saliency", "sift", "orb"} <= set(entry["seconds"])
        assert all(len(samples) == 3 for samples in entry["samples"].values())
        assert all(s["p50"] <= s["p95"] <= s["p99"] for s in entry["seconds"].values())
        assert set(entry["keypoints"]) == {"elf", "sift", "orb"}
        assert set(entry["ratios"]) == {"elf.detect + describe / sift", "elf.detect + describe / orb"}
    text = capsys.readouterr().out
    for expected in (*STAGES, *SUMS, "OpenCV SIFT", "synthetic, seed 0", "import", "load", "64x96"):
        assert expected in text
    assert "ELF detect + describe / OpenCV SIFT, at most 500 keypoints: " in text
    growth = text[text.index("per megapixel") :].splitlines()
    first, last, ratio = (float(row.split()[-1]) for row in (growth[1], growth[2], growth[3]))
    medians = [e["seconds"]["elf.post-processing"]["p50"] * 1e9 / (e["height"] * e["width"]) for e in report["sizes"]]
    assert [first, last] == pytest.approx(medians, abs=0.051)
    assert ratio == pytest.approx(medians[1] / medians[0], abs=0.0051)


def test_a_preset_is_what_is_timed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    counts = []
    for name in ("multiscale", "accurate"):
        given = ["--sizes", "96x128", "--peers", "none", "--preset", name, "--json", tmp_path / "b.json"]
        assert bench(*given) == 0
        report = json.loads((tmp_path / "b.json").read_text())
        assert report["preset"] == name
        assert f"preset {name}" in capsys.readouterr().out
        counts.append(report["sizes"][0]["keypoints"]["elf"])
    elf, image = ElfRuntime(TINY, threads=1), synthetic(96, 128)
    assert counts == [len(elf.detect(image, preset=name)) for name in ("multiscale", "accurate")]
    assert counts[0] != counts[1]


def test_settings_are_what_is_timed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = ["--sizes", "96x128", "--peers", "none", "--set", "max_keypoints=7", "--set", "oriented=true"]
    assert bench(*given, "--json", tmp_path / "b.json") == 0
    report = json.loads((tmp_path / "b.json").read_text())
    assert report["set"] == ["max_keypoints=7", "oriented=true"]
    assert report["sizes"][0]["keypoints"]["elf"] == 7
    assert "preset default, max_keypoints=7, oriented=true" in capsys.readouterr().out
    assert bench("--sizes", "96x128", "--peers", "none", "--set", "speed=1") == 2
    assert "unknown detection setting 'speed'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("target", "status", "reason"),
    [("link.json", 2, "link.json is the image"), ("nodir/b.json", 1, "there is no folder nodir")],
)
def test_the_report_s_place_is_checked_before_the_work(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    target: str,
    status: int,
    reason: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("elf_runtime.commands.bench.start_up", None)
    cv2.imwrite("p.png", synthetic(64, 64))
    Path("link.json").symlink_to("p.png")
    before = Path("p.png").read_bytes()
    assert bench("--image", "p.png", "--peers", "none", "--json", target) == status
    assert f"--json: {reason}" in capsys.readouterr().err
    assert Path("p.png").read_bytes() == before


def test_json_on_standard_output_is_alone_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert bench("--sizes", "64x64", "--peers", "none", "--json", "-") == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["sizes"][0]["ratios"] == {}
    assert "ELF, decode to descriptors" in captured.err


def test_a_photograph_gets_the_size_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), synthetic(60, 70))
    assert bench("--image", tmp_path / "a.png", "--sizes", "48x64", "--peers", "none", "--json", "-") == 0
    entry = json.loads(capsys.readouterr().out)["sizes"][0]
    assert (entry["height"], entry["width"]) == (48, 64)


@pytest.mark.parametrize(("more", "spin"), [([], None), (["--spin"], True)])
def test_every_size_has_its_session_and_threads_spin_as_by_default(more: list[str], spin: bool | None) -> None:
    args = build_parser().parse_args(["--sizes", "48x64,64x48,64x64", "--threads", "1", *more])
    _, options, count = _open(str(TINY), args)._network.given
    assert (options["spin"], options["threads"], count) == (spin, 1, 3)


def test_the_table_is_in_milliseconds_percent_and_mebibytes() -> None:
    entry = {
        "height": 48, "width": 64, "titles": {"elf": "ELF, all of it"}, "keypoints": {"elf": 321},
        "seconds": {"elf": {"p50": 0.0125, "p95": 0.25, "p99": 1.5}},
        "ratios": {}, "saliency_agreement": {"share": 0.9876, "precision": "fp32"},
        "memory": {"peak_loaded_bytes": 2**20, "peak_detect_bytes": 3 * 2**20, "first_detect_s": 0.125},
    }  # fmt: skip
    _, times, agreement, memory, first = _size_rows(entry)
    assert times.split()[-4:] == ["12.50", "250.00", "1500.00", "321"]
    assert "at 98.76 % of the pixels" in agreement
    assert "1 MiB loaded, 3 MiB detecting" in memory
    assert first.endswith("125 ms")


def test_rounds_rotate_and_drop_the_warm_up() -> None:
    log: list[str] = []

    def contender(name: str) -> Workload:
        def run() -> tuple[int | None, dict[str, float]]:
            log.append(name)
            return (5, {"read": 1.0, "nms": 2.0, "blur": 3.0}) if name == "a" else (None, {})

        return Workload(name, name, run)

    samples, keypoints = interleaved([contender(n) for n in "abc"], warmup=1, repeats=2)
    assert "".join(log) == "abc" + "bca" + "cab"
    assert list(samples) == ["a", "a.read", "a.nms", "a.blur", "a.post-processing", "a.detect + describe", "b", "c"]
    assert all(len(values) == 2 for values in samples.values())
    assert samples["a.post-processing"] == samples["a.detect + describe"] == [5.0, 5.0]
    assert keypoints == {"a": 5}


def test_post_processing_is_what_follows_the_network() -> None:
    stages = dict.fromkeys(("read", "prepare", "session"), 100.0) | {
        "blur": 1.0,
        "nms": 2.0,
        "descriptors": 4.0,
    }
    assert with_sums(stages)["post-processing"] == 7.0
    assert with_sums(stages)["detect + describe"] == 207.0
    assert with_sums({}) == {}


def test_the_synthetic_image_is_textured_and_repeats() -> None:
    image = synthetic(120, 160)
    assert image.shape == (120, 160, 3)
    assert image.dtype == np.uint8
    assert image.std() > 20
    np.testing.assert_array_equal(image, synthetic(120, 160))
    assert (image != synthetic(120, 160, seed=1)).any()


def test_sizes_are_height_by_width() -> None:
    assert sizes("480x640,33x47") == [(480, 640), (33, 47)]


@pytest.mark.parametrize("text", ["480", "axb", "480x", "0x640", "480x640,"])
def test_a_wrong_size_is_a_usage_error(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        bench("--sizes", text)
    assert stopped.value.code == 2
    assert "HEIGHTxWIDTH" in capsys.readouterr().err


def test_a_size_below_the_model_s_smallest_is_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    least = ElfRuntime(TINY).contract.input.min_size
    assert bench("--sizes", f"96x96,{least - 1}x64", "--peers", "none") == 2
    error = capsys.readouterr().err
    assert error == f"elf-bench: error: --sizes {least - 1}x64: the smallest size of this model is {least}x{least}\n"


def test_an_unknown_peer_is_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert bench("--peers", "surf") == 2
    assert "unknown peer 'surf'" in capsys.readouterr().err


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the kernel has no VmHWM to read")
def test_peak_memory_is_the_childs_own() -> None:
    # 400 MB in this process must not show in a fresh one, as they would in its ru_maxrss.
    ballast = np.ones(50_000_000)
    found = peak_memory(str(TINY), None, 1, (64, 64))
    loaded, detected = found["peak_loaded_bytes"], found["peak_detect_bytes"]
    assert ballast.nbytes == 400_000_000
    assert loaded is not None
    assert detected is not None
    assert 10e6 < loaded <= detected < 350e6


def test_start_up_is_a_median(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = iter([(1.0, 5.0), (9.0, 4.0), (2.0, 60.0)])
    monkeypatch.setattr(fresh_process, "_run", lambda *_: dict(zip(("import_s", "load_s"), next(runs), strict=True)))
    assert start_up(None, None, 1, 3) == {"processes": 3, "import_s": 2.0, "load_s": 5.0}


def test_a_fresh_process_that_fails_says_why(tmp_path: Path) -> None:
    with pytest.raises(ElfError, match=r"a fresh process failed with status 1: .*none\.onnx: no such file"):
        peak_memory(str(tmp_path / "none.onnx"), None, 1, (64, 64))


def test_the_commands_load_neither_torch_nor_onnx() -> None:
    commands = [f"elf_runtime.commands.{name}" for name in ("bench", "detect", "info", "match")]
    code = f"import sys, {', '.join(commands)}; print([m for m in ('torch', 'onnx') if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path[:0] = {sys.path!r}; {code}"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"


def test_the_benchmark_script_is_the_command() -> None:
    script = ROOT / "benchmarks" / "latency.py"
    code = f"import runpy, sys; sys.path[:0] = {sys.path!r}; sys.argv = ['latency.py', '--help']"
    code += f"; runpy.run_path({str(script)!r}, run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "elf-bench" in done.stdout
