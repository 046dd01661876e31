"""Several runs of elf-detect --engine ray into one folder: what they leave there, whole or stopped.  Ray is not asked:
the shards are made here, one after the other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elf_runtime.commands import detect_ray, match, view
from elf_runtime.extraction.shard_worker import Job, Task, work
from elf_runtime.extraction.shards import read_shards
from runtime.commands.detecting import detect, write

pytest.importorskip("fsspec", reason="needs the extra ray")
pytest.importorskip("pyarrow", reason="needs the extra ray")


class Here:
    """In Ray's place.  A run is stopped before the shard of number `stopped`."""

    stopped: int | None = None

    def run_tasks(self, _: None, job: Job, tasks: Sequence[Task], __: int) -> Iterator[dict[str, Any]]:
        for index, task in enumerate(tasks):
            if index == self.stopped:
                raise KeyboardInterrupt
            yield work(job, task)


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Here:
    made = Here()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(detect_ray, "ray_library", lambda: None)
    monkeypatch.setattr(detect_ray, "ray_session", nullcontext)
    monkeypatch.setattr(detect_ray, "_workers", lambda *_: 1)
    monkeypatch.setattr(detect_ray, "run_tasks", made.run_tasks)
    for index in range(6):
        write(Path("in", f"{index}.png"), index)
    return made


def run(*options: object) -> int:
    return detect("in", "-o", "out", "--engine", "ray", "--shard-size", 2, "--threshold", "none", "-q", *options)


def counts() -> dict[str, int]:
    """Name -> number of keypoints; each name is given once."""
    rows = [(Path(name).name, len(found)) for name, found in read_shards("out")]
    assert len(dict(rows)) == len(rows)
    return dict(sorted(rows))


@pytest.mark.parametrize("ending", ["parquet", "h5"])
def test_of_two_rows_of_an_image_the_newer_is_given(here: Here, ending: str) -> None:
    """Whatever their files' names and times: the run after a stopped one rewrites the oldest shards."""
    if ending == "h5":
        pytest.importorskip("h5py")
    names = [f"{index}.png" for index in range(6)]
    assert run("--format", ending, "--max-keypoints", 3) == 0
    assert counts() == dict.fromkeys(names, 3)
    here.stopped = 2
    for most in (4, 5, 6, 7, 8):  # so many that the order of the names' digests is not that of the runs
        assert run("--format", ending, "--max-keypoints", most, "--skip-existing") == 130
        assert counts() == dict.fromkeys(names[:4], most) | dict.fromkeys(names[4:], 3)
    here.stopped = None
    for name in names[:3]:
        Path("in", name).rename(name)
    assert run("--format", ending, "--max-keypoints", 9, "--skip-existing") == 0  # and takes out of all older shards
    assert counts() == dict.fromkeys(names[:3], 8) | dict.fromkeys(names[3:], 9)


def test_the_last_run_may_have_the_settings_of_an_older_one(here: Here) -> None:
    assert run("--max-keypoints", 3) == 0
    here.stopped = 2
    assert run("--max-keypoints", 4, "--skip-existing") == 130
    here.stopped = None
    assert run("--max-keypoints", 3, "--skip-existing") == 0
    assert set(counts().values()) == {3}
    assert len(list(Path("out").glob("part-*"))) == 3  # those of the first run


def test_what_is_overwritten_stays_until_the_new_is_there(here: Here) -> None:
    assert run("--max-keypoints", 3) == 0
    here.stopped = 1
    assert run("--max-keypoints", 4, "--overwrite") == 130
    assert list(counts().values()) == [4, 4, 3, 3, 3, 3]
    here.stopped = None
    Path("in/5.png").unlink()
    assert run("--max-keypoints", 5, "--overwrite") == 0
    assert counts() == {f"{index}.png": 5 for index in range(5)}


def test_an_image_that_can_not_be_read_any_more_has_no_row(here: Here) -> None:
    assert run() == 0
    before = counts()
    Path("in/1.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    assert run("--skip-existing") == 1
    del before["1.png"]
    assert counts() == before
    assert Path("out/errors.jsonl").read_text().count("\n") == 1


@pytest.mark.parametrize("ending", ["parquet", "h5"])
@pytest.mark.parametrize("kept", [0, 5, 2000])
def test_a_shard_that_was_cut_off_is_done_again(here: Here, ending: str, kept: int) -> None:
    if ending == "h5":
        pytest.importorskip("h5py")
    assert run("--format", ending) == 0
    before = counts()
    first, *others = sorted(Path("out").glob("part-*"))
    first.write_bytes(first.read_bytes()[:kept])
    assert run("--format", ending, "--skip-existing") == 0
    assert counts() == before
    assert not first.exists()
    assert all(other.exists() for other in others)
    others[0].write_bytes(b"another file of this name")  # is no shard, and stays
    assert run("--format", ending, "--skip-existing") == 1
    assert others[0].exists()


@pytest.mark.parametrize("command", [match, view], ids=["match", "view"])
def test_other_commands_say_what_shards_are(here: Here, command: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert run() == 0
    assert command.main(["out"]) == 2
    assert "error: out: no images in this folder, but shards of elf-detect --engine ray: " in capsys.readouterr().err


def test_results_are_those_of_the_local_engine(here: Here) -> None:
    from elf_runtime import Features

    assert run() == 0
    assert detect("in", "-o", "local", "--threshold", "none", "--no-picture", "-q") == 0
    for name, found in read_shards("out"):
        expected = Features.load(Path("local", name).with_suffix(".npz"))
        np.testing.assert_array_equal(found.keypoints, expected.keypoints)
        assert found.record == expected.record
