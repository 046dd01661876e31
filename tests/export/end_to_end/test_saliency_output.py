"""The saliency beside the keypoints of an end-to-end graph: the network's own map at the working size."""

from __future__ import annotations

import cv2
import numpy as np
import onnx
import onnxruntime as ort
import pytest

from elf_export.command.asked import form_of
from elf_export.command.options import parser
from elf_export.end_to_end.build import Form, end_to_end
from elf_runtime import ElfRuntime
from elf_runtime.model import bundled_model
from helpers import ROOT

QUIET = ort.SessionOptions()
QUIET.log_severity_level = 3


@pytest.mark.parametrize("batch", [False, True])
def test_the_map_is_the_network_s(batch: bool) -> None:
    image = cv2.imread(str(ROOT / "demo" / "palace.jpg"))
    elf = ElfRuntime(bundled_model("fp32"))
    graph = end_to_end(onnx.load(bundled_model("fp32")), elf.contract, Form(batch=batch, saliency=True))
    session = ort.InferenceSession(graph.SerializeToString(), QUIET)
    images = np.stack([image, image[::-1]]) if batch else image[None]
    found = session.run(["saliency"], {"image": images})[0]
    assert len(found) == len(images)
    network = ort.InferenceSession(bundled_model("fp32"))
    for mine, one in zip(found, images, strict=True):
        small = cv2.resize(one.astype(np.float32), mine.shape[::-1], interpolation=cv2.INTER_AREA)
        wanted = network.run(["saliency"], {"image": small[None]})[0][0]
        assert mine.shape == wanted.shape
        assert np.quantile(np.abs(mine - wanted) / wanted.max(), 0.999) < 1e-3


def test_only_who_asks_gets_it() -> None:
    elf = ElfRuntime(bundled_model())
    names = [
        [
            output.name
            for output in end_to_end(onnx.load(bundled_model()), elf.contract, Form(saliency=asked)).graph.output
        ]
        for asked in (False, True)
    ]
    assert names == [["keypoints", "scores", "descriptors"], ["keypoints", "scores", "descriptors", "saliency"]]


def test_the_command_can_ask() -> None:
    form = form_of(parser().parse_args(["--net", "vgg", "-o", "x.onnx", "--end-to-end", "saliency", "float32"]))
    assert form == Form("float32", saliency=True)
    assert form.words() == ["--end-to-end", "float32", "saliency"]
