"""One end-to-end file, one photograph, every runtime that is installed: the keypoints of `ElfRuntime.detect`.

A runtime that is not installed is skipped: none of them but onnxruntime is a dependency of the project's.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import onnxruntime as ort
import pytest

from elf_runtime import ElfRuntime
from elf_runtime.model import bundled_model
from helpers import ROOT
from project.chromium import BROWSER, browser
from project.cpp_program import Rows, compiled, end_to_end_model, printed
from project.web_site import FOUND, near, served, whole_site

pytestmark = pytest.mark.torch


def by_onnxruntime(model: Path, image: Path, folder: Path) -> Rows:
    options = ort.SessionOptions()
    options.log_severity_level = 3
    session = ort.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    return np.asarray(session.run(["keypoints"], {"image": cv2.imread(str(image))[None]})[0])


def by_openvino(model: Path, image: Path, folder: Path) -> Rows:
    openvino = pytest.importorskip("openvino", reason="openvino is not installed")
    # In bfloat16, which it takes where the processor has it, sizes and places would be rounded too.
    compiled_model = openvino.Core().compile_model(model, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    picture = cv2.imread(str(image))[None]
    assert len(compiled_model({"image": np.zeros_like(picture)})["keypoints"]) == 0
    assert len(compiled_model({"image": picture})["keypoints"]) > 0
    assert len(compiled_model({"image": np.zeros_like(picture)})["keypoints"]) == 0
    return np.asarray(compiled_model({"image": picture})["keypoints"])


def by_cpp(model: Path, image: Path, folder: Path) -> Rows:
    return printed(compiled(folder / "cpp"), model, image)[:, :2]


def by_opencv(model: Path, image: Path, folder: Path) -> Rows:
    if int(cv2.__version__.split(".")[0]) < 5:
        pytest.skip(f"cv2.dnn of OpenCV {cv2.__version__} can't open such files")
    network = cv2.dnn.readNetFromONNX(str(model))
    network.setInput(cv2.imread(str(image))[None], "image")
    return np.asarray(network.forward(network.getUnconnectedOutLayersNames())[0])


def by_chromium(model: Path, image: Path, folder: Path) -> Rows:
    """onnxruntime-web on WebAssembly, in the page of web/."""
    if BROWSER is None:
        pytest.skip("no Chromium to open the page in")
    site = whole_site(folder / "site")
    for file in (model, image):
        (site / file.name).symlink_to(file)
    with served(site, "serve.py", "0") as address, browser(folder, patience=300) as page:
        page.open(f"{address}?provider=wasm&selftest=1&image={image.name}&model={model.name}")
        return np.array(json.loads(page.wait(FOUND))["keypoints"][0], np.float32)


# In 8 bits OpenVINO rounds one value in fifty otherwise than ONNX Runtime, by a step, which moves places by a tenth of
# a pixel or so; WebAssembly's instructions round a few otherwise.
RUNTIMES = [
    pytest.param(by_onnxruntime, {"fp32": (0.01, 0.995), "int8": (0.01, 0.999)}, id="onnxruntime"),
    pytest.param(by_openvino, {"fp32": (0.01, 0.995), "int8": (0.5, 0.97)}, id="OpenVINO"),
    pytest.param(by_opencv, {"fp32": (0.01, 0.995)}, id="cv2.dnn"),
    pytest.param(by_cpp, {"fp32": (0.01, 0.995), "int8": (0.01, 0.999)}, id="C++"),
    pytest.param(by_chromium, {"fp32": (0.01, 0.995), "int8": (0.01, 0.995)}, id="Chromium"),
]


@pytest.mark.parametrize("precision", ["fp32", "int8"])
@pytest.mark.parametrize(("found_by", "least"), RUNTIMES)
def test_the_same_keypoints(
    found_by: Callable[[Path, Path, Path], Rows], least: dict[str, tuple[float, float]], precision: str, tmp_path: Path
) -> None:
    if precision not in least:
        pytest.skip("cv2.dnn lacks an operator in 8 bits")
    image = tmp_path / "photograph.png"  # decoders of JPEG may differ in a pixel
    cv2.imwrite(str(image), cv2.imread(str(ROOT / "demo" / "palace.jpg")))
    # OpenVINO's Loop is not to be relied on, and cv2.dnn has none.
    model = end_to_end_model(tmp_path / "alone.onnx", precision, rounds=3, opencv=True)
    for name in ("cpp", "site"):
        (tmp_path / name).mkdir()
    found = found_by(model, image, tmp_path)
    wanted = ElfRuntime(bundled_model(precision)).detect(image).keypoints
    assert len(found) == len(wanted) == 500
    pixels, share = least[precision]
    assert near(wanted, found, pixels) >= share
    assert near(found, wanted, pixels) >= share
