"""The folder of web/ as a site, what Python finds where its page looks, and what the page found."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import onnxruntime as ort
import pytest

from elf_runtime import match
from helpers import ROOT
from project.chromium import Page

WEB = ROOT / "web"
FOUND = "document.querySelector('#selftest')?.textContent"


def copied(folder: Path) -> Path:
    for path in WEB.iterdir():
        if path.suffix in {".html", ".css", ".js", ".py"}:
            shutil.copy(path, folder)
    return folder


def whole_site(folder: Path) -> Path:
    """The page with all that `vendor.py` puts beside it; skips where its packages are not installed."""
    pytest.importorskip("onnx")
    modules = Path(os.environ.get("ELF_NODE_MODULES", WEB / "node_modules"))
    if not (modules / "onnxruntime-web").is_dir():
        pytest.skip("npm's onnxruntime-web is not installed (npm install in web)")
    command = [sys.executable, str(WEB / "vendor.py"), str(modules), str(copied(folder) / "vendor")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


@contextmanager
def served(folder: Path, *command: str) -> Iterator[str]:
    """The address of a server that tells it in its first line."""
    with subprocess.Popen(
        [sys.executable, "-u", *command], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as server:
        assert server.stdout is not None
        address = re.search(r"http://[^/]+/", server.stdout.readline())
        try:
            assert address
            yield address[0]
        finally:
            server.kill()


def python_s(site: Path, model: str) -> tuple[list[npt.NDArray[np.float32]], npt.NDArray[np.int64]]:
    """Keypoints of the two pictures and their matches, by ONNX Runtime on the CPU."""
    options = ort.SessionOptions()
    options.log_severity_level = 3
    session = ort.InferenceSession(site / "vendor" / model, options, providers=["CPUExecutionProvider"])
    images = [cv2.imread(str(site / "vendor" / name)) for name in ("palace.jpg", "view.png")]
    found = [session.run(["keypoints", "descriptors"], {"image": image[None]}) for image in images]
    return [keypoints for keypoints, _ in found], match(found[0][1], found[1][1], ratio=0.9)


def near(wanted: npt.ArrayLike, found: npt.ArrayLike, pixels: float = 0.01) -> float:
    """Share of the wanted places with one of the found near."""
    apart = np.abs(np.asarray(wanted, float)[:, None] - np.asarray(found, float)[None]).max(axis=2)
    return float((apart.min(axis=1) <= pixels).mean())


def self_test(page: Page, address: str, **query: str) -> Any:
    words = "&".join(f"{name}={value}" for name, value in query.items())
    page.open(f"{address}?provider=wasm&selftest=1&image=vendor/palace.jpg&image=vendor/view.png&{words}")
    return json.loads(page.wait(FOUND))
