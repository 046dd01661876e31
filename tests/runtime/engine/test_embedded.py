"""What a robot relies on: the same result with any number of threads, and memory that stays bounded."""

from __future__ import annotations

import copy
import json
import os
import pickle
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as ort
import pytest

from elf_runtime import ElfRuntime, ModelError
from elf_runtime.checks.agreement import compare, pattern
from elf_runtime.model import bundled_model, sessions
from helpers import ROOT, TINY, textured

STATUS = Path("/proc/self/status")
# 90 sizes, no two alike; each 15 are those before with a pixel more, so that they need as much at a time.
MEMORY = """
import gc, json, sys
import numpy as np
from elf_runtime import ElfRuntime

def resident():
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmRSS"))

elf = ElfRuntime(threads=1)
rng = np.random.default_rng(0)
found = []
for more in range(6):
    for i in range(15):
        size = 128 + 16 * (7 * i % 15) + more
        if sys.argv[1] == "own":
            elf.warmup((size, size))
        else:
            elf.detect(rng.integers(0, 256, (size, size, 3), np.uint8))
        gc.collect()
        found.append(resident())
print(json.dumps(found))
"""


def resident_over_sizes(session: str) -> list[float]:
    """MiB in use after each of 90 images of different sizes, in a fresh process; "own" or "any" size's session."""
    env = {**os.environ, "PYTHONPATH": str(ROOT / "runtime")}
    command = [sys.executable, "-c", MEMORY, session]
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=True)
    found: list[float] = json.loads(done.stdout)
    return found


@pytest.mark.skipif(not STATUS.exists(), reason="reads resident memory from /proc")
@pytest.mark.parametrize("session", ["any", "own"])
def test_memory_is_bounded_over_sizes(session: str) -> None:
    found = resident_over_sizes(session)
    # Were all sizes' sessions kept, each further 15 would add 44; a heap that is never trimmed grows by 40.
    assert max(found[15:]) - max(found[:15]) < 20, [round(value) for value in found]


OUTLIER = """
import json
import numpy as np
from elf_runtime import ElfRuntime

def status(key):
    with open("/proc/self/status") as file:
        return next(int(line.split()[1]) / 1024 for line in file if line.startswith(key))

elf = ElfRuntime(threads=1)
rng = np.random.default_rng(0)
found = []
for height, width in ((200, 240), (201, 240), (1400, 1200), (202, 240), (203, 240), (204, 240), (204, 240), (204, 240)):
    elf.detect(rng.integers(0, 256, (height, width, 3), np.uint8))
    found.append(status("VmRSS"))
print(json.dumps([found, status("VmHWM")]))
"""


@pytest.mark.skipif(not STATUS.exists(), reason="reads resident memory from /proc")
def test_memory_of_one_large_image_among_small_ones_is_given_back() -> None:
    env = {**os.environ, "PYTHONPATH": str(ROOT / "runtime")}
    done = subprocess.run([sys.executable, "-c", OUTLIER], env=env, capture_output=True, text=True, check=True)
    found, peak = json.loads(done.stdout)
    assert peak - found[1] > 120
    # 8 MiB of 150 stay; 10 to 45 would in a heap that is never trimmed.
    assert max(found[3:]) - found[1] < (found[2] - found[1]) / 4, [round(value) for value in found]


class Runs:
    """A session that remembers what it was run on, and whether its memory was given back after that."""

    def __init__(self, session: ort.InferenceSession, found: list[tuple[int, int, bool]]) -> None:
        self.session, self.found = session, found

    def run(self, names: Any, feeds: dict[str, Any], options: Any) -> Any:
        (pixels,) = feeds.values()
        self.found.append((*pixels.shape[1:3], options is not None))
        return self.session.run(names, feeds, options)


def test_memory_is_given_back_where_sizes_differ_much_and_not_else(monkeypatch: pytest.MonkeyPatch) -> None:
    elf, found = ElfRuntime(TINY, threads=1, sizes=0), list[tuple[int, int, bool]]()
    real = elf._network.sessions.get

    def spy(*args: Any, **options: Any) -> Any:
        session, run_options = real(*args, **options)
        return Runs(session, found), run_options

    monkeypatch.setattr(elf._network.sessions, "get", spy)
    sides = [
        (64, False), (80, False), (130, True), (64, False), (72, False), (90, False), (91, False), (60, True),
        (80, False),
    ]  # fmt: skip
    for side, _ in sides:
        elf.detect(textured(side, side))
    assert found == [(side, side, shrinks) for side, shrinks in sides]
    monkeypatch.setattr(elf._network.sessions, "_is_cpu", False)
    elf.detect(textured(200, 200))
    assert found[-1] == (200, 200, False)


@pytest.mark.parametrize("threads", [1, 2, 3, 4])
def test_threads_do_not_move_a_keypoint(threads: int) -> None:
    found = compare(ElfRuntime(threads=None), ElfRuntime(threads=threads), pattern(120, 160))
    assert found.reference == found.found > 20
    assert found.same == 1.0
    assert found.least_cosine == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("change", ["removed", "replaced"])
def test_the_file_is_read_once(tmp_path: Path, change: str) -> None:
    path = tmp_path / "m.onnx"
    path.write_bytes(bundled_model("fp32").read_bytes())
    elf, image = ElfRuntime(path, threads=1), textured(64, 80)
    if change == "removed":
        path.unlink()
    else:
        path.write_bytes(TINY.read_bytes())
    wanted = ElfRuntime(bundled_model("fp32"), threads=1)
    for size in (64, 48):
        part = image[:size]
        np.testing.assert_array_equal(elf.saliency(part), wanted.saliency(part))
        np.testing.assert_array_equal(elf.detect(part).descriptors, wanted.detect(part).descriptors)
        points = np.array([[20, 20]], np.float32)
        np.testing.assert_array_equal(elf.describe(part, points), wanted.describe(part, points))
    assert str(path) in repr(elf)


def test_a_session_that_does_not_open_is_not_laid_to_the_image(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: Any, **__: Any) -> None:
        raise ModelError("m.onnx: can't load it")

    elf = ElfRuntime(TINY)
    monkeypatch.setattr(sessions, "open_session", refused)
    with pytest.raises(ModelError, match=r"^m\.onnx: can't load it$"):
        elf.detect(textured(64, 80))


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda elf: pickle.loads(pickle.dumps(elf))])
@pytest.mark.parametrize("given", ["bundled", "path", "bytes"])
def test_a_copy_opens_the_same_model(tmp_path: Path, given: str, copied: Any) -> None:
    path = tmp_path / "m.onnx"
    path.write_bytes(TINY.read_bytes())
    model = {"bundled": None, "path": path, "bytes": path.read_bytes()}[given]
    elf, image = ElfRuntime(model, threads=1, spin=False, sizes=3), textured(96, 128)
    path.unlink()
    other = copied(elf)
    assert repr(other) == repr(elf)
    assert other._network.given == elf._network.given
    np.testing.assert_array_equal(other.detect(image, border=4).keypoints, elf.detect(image, border=4).keypoints)


def test_a_process_pool_takes_an_instance() -> None:
    elf, images = ElfRuntime(TINY, threads=1), [textured(64, 80, seed) for seed in range(2)]
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        found = list(pool.map(elf.detect, images))
    for features, image in zip(found, images, strict=True):
        np.testing.assert_array_equal(features.keypoints, elf.detect(image).keypoints)


def test_a_graph_that_onnxruntime_refuses_is_refused_at_once() -> None:
    broken = TINY.read_bytes().replace(b"MaxPool", b"MaxPoox")
    with pytest.raises(ModelError, match="can't load it"):
        ElfRuntime(broken)


@pytest.mark.skipif("CoreMLExecutionProvider" in ort.get_available_providers(), reason="CoreML is installed")
def test_a_provider_that_is_missing_warns_once() -> None:
    with pytest.warns(RuntimeWarning, match="CoreML") as caught:
        elf = ElfRuntime(TINY, providers=["coreml", "cpu"], fallback=True)
    assert len(caught) == 1
    assert elf.providers == ["CPUExecutionProvider"]
