"""The page of web/ in headless Chromium: Python's keypoints, the camera, and what it says when something is missing.

Its packages are looked for in web/node_modules; ``$ELF_NODE_MODULES`` may name another folder.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from elf_runtime import match
from elf_runtime.model import bundled_model
from project.chromium import BROWSER, Page, browser
from project.web_site import FOUND, WEB, copied, near, python_s, self_test, served, whole_site

STATUS = "document.querySelector('#status').textContent"
ERROR = "document.querySelector('#error').textContent"

pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium to open the page in")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page with all that `vendor.py` puts beside it."""
    folder = whole_site(tmp_path_factory.mktemp("site"))
    shutil.copy(bundled_model(), folder / "maps.onnx")
    return folder


@pytest.fixture(scope="module")
def address(site: Path) -> Iterator[str]:
    with served(site, "serve.py", "0") as url:
        yield url


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with browser(tmp_path_factory.mktemp("browser"), "--use-fake-device-for-media-stream") as opened:
        yield opened


# 8 bits round differently where a processor has other instructions for them; noise shows it more than a photograph.
@pytest.mark.parametrize(
    ("model", "least"), [("elf-fast-int8.onnx", (0.99, 0.95, 0.9)), ("elf-fast-fp32.onnx", (0.99, 0.99, 0.99))]
)
def test_the_page_finds_python_s_keypoints(
    page: Page, address: str, site: Path, model: str, least: tuple[float, float, float]
) -> None:
    found = self_test(page, address, model=f"vendor/{model}", threads="2")
    assert found["place"] == "WebAssembly, 2 threads"
    keypoints, matches = python_s(site, model)
    for wanted, there, share in zip(keypoints, found["keypoints"], least, strict=False):
        assert len(wanted) > 300
        assert near(wanted, there) >= share
        assert near(there, wanted) >= share
    assert len(matches) > 200
    assert near(matches, found["matches"], 0) >= least[2]
    assert found["isolated"]


def test_webgpu_finds_what_webassembly_finds(address: str, tmp_path: Path) -> None:
    """In Chromium's software GPU, slowly, so on a small picture."""
    flags = ("--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader", "--enable-features=Vulkan")
    query = f"{address}?selftest=1&size=192&image=vendor/palace.jpg&model=vendor/elf-fast-fp32.onnx"
    found = []
    with browser(tmp_path, *flags, patience=300) as page:
        page.open(f"{query}&provider=wasm")
        found.append(json.loads(page.wait(FOUND)))
        if not page.ask("navigator.gpu && navigator.gpu.requestAdapter().then(Boolean)"):
            pytest.skip("this Chromium has no WebGPU in software")
        page.open(f"{query}&provider=webgpu")
        found.append(json.loads(page.wait(FOUND)))
    assert [there["place"].split(",")[0] for there in found] == ["WebAssembly", "WebGPU"]
    (wanted,), (there,) = (there["keypoints"] for there in found)
    assert len(wanted) > 10
    assert near(wanted, there) >= 0.9


def test_the_bundled_model_in_8_bits_is_what_webassembly_gets(page: Page, address: str) -> None:
    page.open(f"{address}?selftest=1&provider=wasm")
    assert page.wait(STATUS + ".includes('Self test')")
    found = json.loads(page.ask(FOUND))
    assert found["equal"][0] >= 0.99
    assert found["equalMatches"] >= 0.9
    told = page.ask("document.querySelector('#runs-on').textContent")
    assert "elf-fast-int8.onnx on WebAssembly" in told
    assert "\u201cfast\u201d" in told


def test_any_static_host_does_with_one_thread(page: Page, site: Path) -> None:
    with served(site, "-m", "http.server", "0", "--bind", "127.0.0.1") as address:
        found = self_test(page, address)
    assert found["place"] == "WebAssembly, 1 thread"
    assert not found["isolated"]
    assert near(python_s(site, "elf-fast-int8.onnx")[0][0], found["keypoints"][0]) >= 0.99


def test_a_smaller_size_keeps_the_places(page: Page, address: str, site: Path, tmp_path: Path) -> None:
    """Of a picture of doubled pixels, seen at half its size, keypoints are the picture's own, doubled."""
    twice = tmp_path / "twice.png"
    cv2.imwrite(str(twice), cv2.imread(str(site / "vendor" / "palace.jpg")).repeat(2, axis=0).repeat(2, axis=1))
    shutil.copy(twice, site / "twice.png")
    page.open(f"{address}?provider=wasm&selftest=1&size=640&image=twice.png")
    found = json.loads(page.wait(FOUND))
    wanted = 2 * (python_s(site, "elf-fast-int8.onnx")[0][0] + 0.5) - 0.5
    assert near(wanted, found["keypoints"][0], 0.1) >= 0.95


def test_files_and_settings(page: Page, address: str, site: Path, tmp_path: Path) -> None:
    page.open(f"{address}?provider=wasm")
    page.wait("document.querySelector('#runs-on').textContent.includes('elf-fast')")
    page.choose_files("#images", site / "vendor" / "palace.jpg")
    assert re.match(r"palace.jpg: \d+ keypoints, 640x427, \d+ ms$", page.wait(f"{STATUS}.includes('ms') && {STATUS}"))
    before = page.ask("document.querySelector('#stage').toDataURL()")
    page.ask("document.querySelector('#overlay').click()")
    assert page.ask("document.querySelector('#stage').toDataURL()") != before

    page.choose_files("#images", site / "vendor" / "palace.jpg", site / "vendor" / "view.png")
    most = int(page.wait(rf"{STATUS}.match(/(\d+) matches/)?.[1]"))
    for setting, value, shown in (("count", 50, "50 keypoints"), ("size", 320, "320x214")):
        page.ask(
            f"(() => {{ const control = document.querySelector('#{setting}'); control.value = {value}; "
            "for (const kind of ['input', 'change']) control.dispatchEvent(new Event(kind)); })()"
        )
        page.wait(f"{STATUS}.split('{shown}').length === 3")
    assert int(page.ask(rf"{STATUS}.match(/(\d+) matches/)[1]")) < most

    text = tmp_path / "text.png"
    text.write_text("text")
    page.choose_files("#images", text)
    assert page.wait(ERROR) == "text.png is no picture that this browser can read"


def test_the_camera_and_a_kept_frame(page: Page, address: str) -> None:
    page.open(f"{address}?provider=wasm")
    page.wait("document.querySelector('#runs-on').textContent.includes('elf-fast')")
    page.ask("document.querySelector('#camera').click()")
    page.wait(rf"/camera: \d+ keypoints.* [\d.]+ frames.s/.test({STATUS})")
    page.ask("document.querySelector('#keep').click()")
    page.wait(rf"/kept frame: .*camera: .*\d+ matches/.test({STATUS})")
    page.ask("document.querySelector('#camera').click()")
    assert page.ask("document.querySelector('#keep').disabled")
    assert page.ask(ERROR) == ""


@pytest.mark.parametrize(
    ("name", "words"), [("NotFoundError", "no camera: there is none"), ("NotAllowedError", "its use was not allowed")]
)
def test_no_camera_is_said(page: Page, address: str, name: str, words: str) -> None:
    page.open(f"{address}?provider=wasm")
    page.wait("document.querySelector('#runs-on').textContent.includes('elf-fast')")
    page.ask(f"void (navigator.mediaDevices.getUserMedia = () => Promise.reject(new DOMException('', '{name}')))")
    page.ask("document.querySelector('#camera').click()")
    assert words in page.wait(ERROR)


def test_other_models_are_refused(page: Page, address: str) -> None:
    page.open(f"{address}?provider=wasm&model=maps.onnx")
    told = page.wait(ERROR)
    assert "maps.onnx can't be run: its inputs are image, its outputs saliency" in told
    assert "elf-export --end-to-end" in told


def test_a_page_without_its_files_says_so(page: Page, tmp_path: Path) -> None:
    with served(copied(tmp_path), "serve.py", "0") as address:
        page.open(f"{address}?provider=wasm")
        told = page.wait(ERROR)
    assert told == 'vendor/elf-fast-int8.onnx can\'t be loaded (404): "make web" puts there what the page needs'


@pytest.mark.parametrize("ratio", [1.0, 0.8])
def test_matches_are_the_runtime_s(page: Page, tmp_path: Path, ratio: float) -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(60, 8)), rng.normal(size=(40, 8))
    b[5] = b[6] = a[7]  # a tie, which fails any ratio
    a, b = ((x / np.linalg.norm(x, axis=1, keepdims=True)).astype(np.float32) for x in (a, b))
    wanted = match(a, b, ratio=ratio if ratio < 1 else None)
    with served(copied(tmp_path), "serve.py", "0") as address:
        page.open(f"{address}?provider=wasm")
        arrays = ", ".join(f"Float32Array.from({json.dumps(x.ravel().tolist())})" for x in (a, b))
        ask = "import('./matching.js').then(({{ mutualMatches }}) => mutualMatches({}, 8, {}))"
        found = page.ask(ask.format(arrays, ratio))
        nothing = page.ask(ask.format(f"new Float32Array(0), {arrays.split(', Float')[0]}", ratio))
    assert len(wanted) > 3
    assert found == wanted.tolist()
    assert nothing == []


def test_the_page_loads_nothing_from_elsewhere() -> None:
    for path in WEB.iterdir():
        if path.suffix in {".html", ".css", ".js"}:
            assert "//" not in re.sub(r"(^|\s)//.*", "", path.read_text(encoding="utf-8")), path
    assert "default-src 'self'" in (WEB / "index.html").read_text(encoding="utf-8")


def test_vendor_says_what_is_missing(tmp_path: Path) -> None:
    pytest.importorskip("onnx")
    command = [sys.executable, str(WEB / "vendor.py"), str(tmp_path), str(tmp_path / "vendor")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "npm install" in done.stderr
