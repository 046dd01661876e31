"""elf-detect --engine ray from and to an object store: a server of this machine that speaks S3 (moto, s3fs)."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from elf_runtime.commands.detect import main
from elf_runtime.extraction.shards import read_shards
from elf_runtime.results.features import Features
from helpers import TINY
from runtime.commands.detecting import write

server = pytest.importorskip("moto.server", reason="needs moto[server], which no extra installs")
s3fs = pytest.importorskip("s3fs", reason="needs s3fs, which no extra installs")
pytest.importorskip("ray", reason="needs the extra ray")

pytestmark = [pytest.mark.filterwarnings("ignore"), pytest.mark.xdist_group("ray")]


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The URL of an empty bucket; the environment says where it is, for this process and Ray's."""
    running = server.ThreadedMotoServer(port=0)
    running.start()
    host, port = running.get_host_and_port()
    settings = {
        "FSSPEC_S3_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_DEFAULT_REGION": "us-east-1",
        "RAY_ADDRESS": "local",
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
    }
    for name, value in settings.items():
        monkeypatch.setenv(name, value)
    import fsspec

    fsspec.config.set_conf_env(fsspec.config.conf)
    s3fs.S3FileSystem().mkdir("elf")
    yield "s3://elf"
    fsspec.config.conf.pop("s3", None)
    running.stop()


def test_images_and_shards_are_in_a_bucket(bucket: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images = [write(tmp_path / "in" / f"{index}.png", seed=index) for index in range(4)]
    s3fs.S3FileSystem().put(str(tmp_path / "in"), "elf/in", recursive=True)
    options = ("--model", str(TINY), "--threads", "1")
    run = ("-o", f"{bucket}/out", "--engine", "ray", "--shard-size", "2", *options)
    assert main([f"{bucket}/in/*.png", *run]) == 0
    assert main([str(image) for image in images] + ["-o", str(tmp_path / "out"), *options]) == 0
    rows = list(read_shards(f"{bucket}/out"))
    assert [name for name, _ in rows] == ["0.png", "1.png", "2.png", "3.png"]
    for name, found in rows:
        expected = Features.load(tmp_path / "out" / f"{Path(name).stem}.npz")
        np.testing.assert_array_equal(found.keypoints, expected.keypoints)
        np.testing.assert_array_equal(found.descriptors, expected.descriptors)
    assert len(s3fs.S3FileSystem().ls("elf/out", refresh=True)) == 2
    capsys.readouterr()
    assert main([bucket, "-r", "--base", f"{bucket}/in", *run, "--skip-existing"]) == 0
    assert "4 skipped" in capsys.readouterr().out
