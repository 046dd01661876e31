"""The example of a server answers with what `detect` finds, and with an error where there is none to find."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator

import numpy as np
import pytest

from elf_runtime import ElfRuntime
from helpers import ROOT

PALACE = ROOT / "demo" / "palace.jpg"


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    env = {**os.environ, "PYTHONPATH": str(ROOT / "runtime")}
    command = [sys.executable, str(ROOT / "examples" / "docker" / "server.py"), "--port", "0"]
    with subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        match = re.fullmatch(r"listening on (127\.0\.0\.1:\d+)\n", process.stdout.readline())
        assert match
        yield f"http://{match[1]}/"
        process.terminate()


def answer(address: str, data: bytes | None) -> tuple[int, dict[str, object]]:
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    try:
        with opener.open(urllib.request.Request(address, data=data), timeout=60) as response:
            return response.status, json.load(response)
    except urllib.error.HTTPError as error:
        with error:
            return error.code, json.load(error)


def test_a_picture_gives_its_keypoints(address: str) -> None:
    status, found = answer(address, PALACE.read_bytes())
    wanted = ElfRuntime().detect(PALACE)
    assert (status, found["size"]) == (200, [427, 640])
    np.testing.assert_allclose(found["keypoints"], wanted.keypoints, atol=2e-3)
    np.testing.assert_array_equal(np.shape(found["descriptors"]), (500, 128))


def test_what_is_no_picture_is_an_error(address: str) -> None:
    status, found = answer(address, b"no picture")
    assert status == 422
    assert str(found["error"]).startswith("the image")
    assert answer(address, b"")[0] == 413
    assert answer(address, None)[0] == 200
