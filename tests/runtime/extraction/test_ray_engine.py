"""elf-detect --engine ray gives what the local engine gives, each image once, though workers die."""

from __future__ import annotations

import json
import os
import signal
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elf_runtime.commands.detect import main
from elf_runtime.errors import ElfError
from elf_runtime.extraction.shards import read_shards
from elf_runtime.results.features import Features
from helpers import TINY
from runtime.commands.detecting import write

pytest.importorskip("fsspec", reason="needs the extra ray")
pytest.importorskip("pyarrow", reason="needs the extra ray")

# Ray's own: it leaves pipes and processes to the garbage collector, and warns of what it will change.
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
    pytest.mark.xdist_group("ray"),
]


@pytest.fixture(scope="module")
def ray() -> Iterator[Any]:
    """A Ray of this machine with two cores, for all tests of this file."""
    with warnings.catch_warnings(), pytest.MonkeyPatch.context() as patch:
        warnings.simplefilter("ignore")
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))  # of this checkout, for the workers
        library = pytest.importorskip("ray", reason="needs the extra ray")
        pytest.importorskip("ray.data", reason="needs the extra ray")
        library.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
        yield library
        library.shutdown()


@pytest.fixture
def disk() -> None:
    """The file system `disk`, for this process; workers get it with what they are to read."""
    import fsspec

    from runtime.extraction.disk import Disk

    fsspec.register_implementation("disk", Disk, clobber=True)


def detect(*arguments: object) -> int:
    return main([*map(str, arguments), "--model", str(TINY), "--threads", "1"])


def photos(folder: Path, count: int = 6) -> list[Path]:
    return [write(folder / f"{index}.png", seed=index) for index in range(count)]


def same(a: Features, b: Features) -> None:
    np.testing.assert_array_equal(a.keypoints, b.keypoints)
    np.testing.assert_array_equal(a.scores, b.scores)
    np.testing.assert_array_equal(a.descriptors, b.descriptors)


def test_both_engines_find_the_same(
    ray: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Features, record and report; and an image that can't be read is an error of its own."""
    monkeypatch.chdir(tmp_path)
    photos(Path("in/x"))
    Path("in/x/damaged.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    assert detect("in", "-r", "-o", "local", "--json", "local.json") == 1
    capsys.readouterr()
    ours = ("--engine", "ray", "--workers", 2, "--shard-size", 3, "--json", "ray.json", "--jsonl", "ray.jsonl")
    assert detect("in", "-r", "-o", "ray", *ours) == 1
    said = capsys.readouterr()
    assert "7 images" in said.out
    assert "1 failed" in said.out
    assert "damaged.png" in said.err

    rows = list(read_shards("ray"))
    assert sorted(name for name, _ in rows) == [f"in/x/{index}.png" for index in range(6)]
    assert len(list(Path("ray").glob("part-*.parquet"))) == 2  # the last one has the damaged image only
    for name, found in rows:
        expected = Features.load(Path("local", name).with_suffix(".npz"))
        same(expected, found)
        assert found.record == expected.record
    (error,) = map(json.loads, Path("ray/errors.jsonl").read_text().splitlines())
    assert error["name"] == "in/x/damaged.png"

    summaries = [json.loads(Path(f"{engine}.json").read_text()) for engine in ("local", "ray")]
    images = [{Path(image["image"]).name: image for image in summary.pop("images")} for summary in summaries]
    assert summaries[0] == summaries[1]
    assert images[0].keys() == images[1].keys()
    for name in images[0].keys() - {"damaged.png"}:
        assert images[0][name].keys() | {"name"} == images[1][name].keys()
        assert images[0][name]["keypoints"] == images[1][name]["keypoints"] > 0
    assert len(Path("ray.jsonl").read_text().splitlines()) == 7


@pytest.mark.parametrize("place", ["in/4.png", "out"], ids=["while it reads", "after it wrote"])
def test_a_worker_that_is_killed_costs_no_image(
    ray: Any, disk: None, place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each image is there once and as the local engine has it; from one file system to another."""
    images = photos(tmp_path / "in")
    kills = tmp_path / f"{place}.kills"
    kills.write_text("1")
    given, output = (f"disk://{tmp_path.as_posix()}/{name}" for name in ("in", "out"))
    assert detect(given, "-o", output, "--engine", "ray", "--shard-size", 3) == 0
    assert kills.read_text() == "0", "nothing was killed"
    assert "1 times a worker had died" in capsys.readouterr().out
    rows = list(read_shards(output))
    assert sorted(name for name, _ in rows) == [path.name for path in images]
    assert detect(*images, "-o", tmp_path / "local", "--base", tmp_path / "in") == 0
    for name, found in rows:
        same(Features.load(tmp_path / "local" / f"{Path(name).stem}.npz"), found)
        assert (found.record or {})["image"] == f"{given}/{name}"
    assert all(path.name.startswith("part-") for path in (tmp_path / "out").iterdir())


def test_an_image_that_kills_every_worker_stops_no_other(ray: Any, disk: None, tmp_path: Path) -> None:
    photos(tmp_path / "in", 3)
    (tmp_path / "in" / "1.png.kills").write_text("9")
    output = tmp_path / "out"
    assert detect(f"disk://{tmp_path.as_posix()}/in", "-o", output, "--engine", "ray", "--shard-size", 3, "-q") == 1
    assert [name for name, _ in read_shards(output)] == ["0.png", "2.png"]
    (error,) = map(json.loads, (output / "errors.jsonl").read_text().splitlines())
    assert "2 workers died of it" in error["error"]
    assert sorted(path.suffix for path in output.iterdir()) == [".jsonl", ".parquet"]


def test_what_is_there_is_not_done_again(ray: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By content and settings; what changed takes the place of what was there.  With hloc's shards."""
    pytest.importorskip("h5py", reason="needs the extra h5")
    photos(tmp_path / "in", 4)
    run = (tmp_path / "in", "-o", tmp_path / "out", "--engine", "ray", "--format", "h5", "--shard-size", 2)
    assert detect(*run) == 0
    before = dict(read_shards(tmp_path / "out"))
    assert detect(*run) == 2
    assert "--skip-existing" in capsys.readouterr().err
    write(tmp_path / "in" / "1.png", seed=99)
    write(tmp_path / "in" / "4.png", seed=4)
    assert detect(*run, "--skip-existing") == 0
    assert "5 images" in (said := capsys.readouterr().out)
    assert "3 skipped" in said
    rows = list(read_shards(tmp_path / "out"))
    assert sorted(name for name, _ in rows) == [f"{index}.png" for index in range(5)]
    after = dict(rows)
    for name in ("0.png", "2.png", "3.png"):
        same(before[name], after[name])
    assert not np.array_equal(before["1.png"].scores, after["1.png"].scores)
    assert detect(*run, "--overwrite", "--max-keypoints", "3") == 0
    assert [len(found) for _, found in read_shards(tmp_path / "out")] == [3] * 5


def test_an_output_that_takes_nothing_ends_the_run(
    ray: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photos(tmp_path / "in", 1)
    (tmp_path / "file").write_text("no folder")
    assert detect(tmp_path / "in", "-o", f"file://{tmp_path}/file/out", "--engine", "ray") == 1
    assert "file/out" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("clip.mp4",), "for images"),
        (("in", "--picture"), "--picture"),
        (("in", "--limit", "3"), "--limit"),
        (("in", "--skip-existing", "--overwrite"), "give one"),
        ((), "nothing to detect in"),
        (("in/0.png", "in/x/0.png", "--base", "elsewhere"), "not below it"),
        (("nowhere://bucket/photos",), "nowhere"),
    ],
)
def test_what_is_not_for_many_machines_is_refused(
    arguments: tuple[str, ...], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    pytest.importorskip("ray", reason="needs the extra ray")
    monkeypatch.chdir(tmp_path)
    photos(Path("in"), 1)
    assert detect(*arguments, "-o", "out", "--engine", "ray") in (1, 2)
    assert said in capsys.readouterr().err
    assert not Path("out").exists()


def test_two_images_of_one_name_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("ray", reason="needs the extra ray")
    photos(tmp_path / "a", 1)
    photos(tmp_path / "b", 1)
    assert detect(tmp_path / "a", tmp_path / "b", "-o", tmp_path / "out", "--engine", "ray") == 2
    assert "give --base" in capsys.readouterr().err


def test_a_worker_of_another_version_or_model_is_refused(tmp_path: Path) -> None:
    from elf_runtime.extraction.shard_worker import Job, ShardWorker, Task, work
    from elf_runtime.extraction.store import Store

    report = json.loads(ShardWorker("0.0.0", b"")({"task": [b""]})["report"][0])
    assert "0.0.0" in report["failed"]
    from elf_runtime import ElfRuntime

    elf = ElfRuntime(TINY, threads=1)
    job = Job(elf, elf.params(), None, None, {"model_sha256": "another"}, Store.at(str(tmp_path)))
    with pytest.raises(ElfError, match="same package"):
        work(job, Task("part-0001-0123456789ab-00000.parquet", []))


def test_what_ray_says_is_a_line_without_colours() -> None:
    from elf_runtime.extraction.ray_engine import _rows

    class Reports:
        def iter_rows(self) -> Iterator[Any]:
            error = RuntimeError("\x1b[36mray::MapWorker(pid=7)\x1b[39m died\n  Traceback")
            error.cause = self.cause  # type: ignore[attr-defined]
            yield {"report": ""}
            raise error

        cause: Any = None

    reports = Reports()
    for reports.cause, said in ((None, "Ray: ray::MapWorker(pid=7) died"), (KeyError("x"), "Ray: 'x'")):
        with pytest.raises(ElfError) as caught:
            list(_rows(reports))
        assert str(caught.value) == said


def test_ray_does_not_keep_the_signals() -> None:
    """Else a run that is terminated would say nothing, and end with Ray's own status."""
    from elf_runtime.extraction.ray_engine import _own_signals

    before = signal.getsignal(signal.SIGTERM)
    with _own_signals():
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    assert signal.getsignal(signal.SIGTERM) == before
