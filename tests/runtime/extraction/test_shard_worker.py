"""What a worker does with a shard's images, whatever becomes of one of them; without Ray."""

from __future__ import annotations

import json
import os
import pickle
from pathlib import Path
from typing import Any

import pytest

from elf_runtime import ElfRuntime
from elf_runtime.engine import runtime
from elf_runtime.errors import ElfError
from elf_runtime.extraction.frames import Still
from elf_runtime.extraction.shard_worker import MOST_DEATHS, Job, ShardWorker, Task, work
from elf_runtime.extraction.shards import read_shards
from elf_runtime.extraction.store import Store
from helpers import TINY
from runtime.commands.detecting import write

pytest.importorskip("fsspec", reason="needs the extra ray")
pytest.importorskip("pyarrow", reason="needs the extra ray")

SHARD = "part-0001-0123456789ab-00000"
Trace = runtime.ElfRuntime.trace


class Killed(BaseException):
    """What ends a worker here, in place of a signal."""


@pytest.fixture(scope="module")
def elf() -> ElfRuntime:
    return ElfRuntime(TINY, threads=1)


def job(elf: ElfRuntime, folder: Path) -> Job:
    """Of a new run."""
    record = {"model_sha256": elf.sha256}
    return Job(elf, elf.params(), None, None, record, Store.at(str(folder)))


def task(folder: Path, ending: str = "parquet") -> Task:
    images = sorted(path for path in folder.iterdir() if path.suffix == ".png")
    return Task(f"{SHARD}.{ending}", [Still(path, Path(path.name)) for path in images])


def failing(monkeypatch: pytest.MonkeyPatch, error: BaseException, which: int) -> None:
    """Have the detection in the image of that place among those of each call of `work` fail."""
    count = iter(range(1000))

    def trace(self: ElfRuntime, *args: Any, **options: Any) -> Any:
        if next(count) == which:
            raise error
        return Trace(self, *args, **options)

    monkeypatch.setattr(runtime.ElfRuntime, "trace", trace)


@pytest.mark.parametrize("ending", ["parquet", "h5"])
@pytest.mark.skipif(os.name == "nt", reason="names are Unicode there")
def test_a_name_that_is_no_unicode_costs_that_image_alone(elf: ElfRuntime, tmp_path: Path, ending: str) -> None:
    if ending == "h5":
        pytest.importorskip("h5py")
    folder = tmp_path / "in"
    images = [write(folder / f"{index}.png", index) for index in range(2)]
    name = os.fsdecode(b"not\xffutf.png")
    (folder / name).write_bytes(images[0].read_bytes())
    found = work(job(elf, tmp_path / "out"), task(folder, ending))["results"]
    assert [name for name, _ in read_shards(tmp_path / "out")] == ["0.png", "1.png"]
    (failed,) = [result for result in found if "error" in result]
    assert failed["error"] == f"{folder}/not\\udcffutf.png: its name, or that of its folder, is no Unicode, and " + (
        "shards take no other; rename it"
    )
    json.dumps(found).encode()


@pytest.mark.skipif(os.name == "nt", reason="names are Unicode there")
def test_nor_does_a_folder_of_such_a_name_that_a_link_leads_to(elf: ElfRuntime, tmp_path: Path) -> None:
    image = write(tmp_path / "in" / "1.png")
    odd = tmp_path / os.fsdecode(b"folder\xff")
    odd.mkdir()
    (odd / "x.png").write_bytes(image.read_bytes())
    (tmp_path / "in" / "0.png").symlink_to(odd / "x.png")
    found = work(job(elf, tmp_path / "out"), task(tmp_path / "in"))["results"]
    assert ["no Unicode" in result.get("error", "") for result in found] == [True, False]
    assert [name for name, _ in read_shards(tmp_path / "out")] == ["1.png"]


@pytest.mark.parametrize("error", [ValueError("odd\nmore"), KeyError("x"), MemoryError(), ElfError("bad")], ids=repr)
def test_any_error_of_an_image_is_that_image_s(
    elf: ElfRuntime, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    for index in range(3):
        write(tmp_path / "in" / f"{index}.png", index)
    failing(monkeypatch, error, 1)
    found = work(job(elf, tmp_path / "out"), task(tmp_path / "in"))["results"]
    expected = {ValueError: "ValueError: odd", KeyError: "KeyError: 'x'", MemoryError: "MemoryError"}
    assert found[1]["error"] == f"{tmp_path}/in/1.png: {expected.get(type(error), 'bad')}"
    assert [name for name, _ in read_shards(tmp_path / "out")] == ["0.png", "2.png"]


def test_so_is_one_while_it_is_read(elf: ElfRuntime, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for index in range(2):
        write(tmp_path / "in" / f"{index}.png", index)
    given = task(tmp_path / "in")
    opened = Still.open

    def fails(self: Still, max_pixels: int | None) -> Any:
        if self.path.name == "0.png":
            raise RuntimeError("no such luck")
        return opened(self, max_pixels)

    monkeypatch.setattr(Still, "open", fails)
    found = work(job(elf, tmp_path / "out"), given)["results"]
    assert found[0]["error"] == f"{tmp_path}/in/0.png: RuntimeError: no such luck"
    assert [name for name, _ in read_shards(tmp_path / "out")] == ["1.png"]


def test_an_unknown_error_of_a_whole_shard_is_told_in_a_line(
    elf: ElfRuntime, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "in" / "0.png")

    def fails(*_: object) -> None:
        raise RuntimeError("no luck\nat all")

    monkeypatch.setattr("elf_runtime.extraction.shard_worker.write_shard", fails)
    from elf_runtime import __version__

    worker = ShardWorker(__version__, pickle.dumps(job(elf, tmp_path / "out")))
    (text,) = worker({"task": [pickle.dumps(task(tmp_path / "in"))]})["report"]
    assert json.loads(text) == {"failed": "RuntimeError: no luck"}


def test_runs_that_were_killed_are_no_image_s_fault(
    elf: ElfRuntime, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However often the command is stopped within the same image, the next run does it."""
    for index in range(3):
        write(tmp_path / "in" / f"{index}.png", index)
    for _ in range(MOST_DEATHS + 2):
        failing(monkeypatch, Killed(), 1)
        with pytest.raises(Killed):
            work(job(elf, tmp_path / "out"), task(tmp_path / "in"))
    monkeypatch.undo()
    report = work(job(elf, tmp_path / "out"), task(tmp_path / "in"))
    assert report["deaths"] == 0
    assert not any("error" in result for result in report["results"])
    assert [name for name, _ in read_shards(tmp_path / "out")] == ["0.png", "1.png", "2.png"]


def test_an_image_that_kills_the_workers_of_a_run_is_given_up(
    elf: ElfRuntime, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for index in range(3):
        write(tmp_path / "in" / f"{index}.png", index)
    run = job(elf, tmp_path / "out")
    for _ in range(MOST_DEATHS + 1):  # the first one takes no notes
        failing(monkeypatch, Killed(), 1)
        with pytest.raises(Killed):
            work(pickle.loads(pickle.dumps(run)), task(tmp_path / "in"))
    monkeypatch.undo()
    report = work(run, task(tmp_path / "in"))
    assert report["deaths"] == MOST_DEATHS + 1
    assert "2 workers died of it" in report["results"][1]["error"]
    assert [name for name, _ in read_shards(tmp_path / "out")] == ["0.png", "2.png"]
