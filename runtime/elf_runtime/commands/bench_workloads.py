"""What elf-bench times, and the image that it times it on."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from elf_runtime.engine import ElfRuntime
from elf_runtime.model.bundled import bundled_model
from elf_runtime.model.ort_format import is_ort_format
from elf_runtime.params import DetectionParams
from elf_runtime.timing.interleave import Workload

Image = npt.NDArray[np.uint8]
PEERS = ("torch", "sift", "orb")
PEER_KEYPOINTS = 500


def ours(elf: ElfRuntime, file: Path, params: DetectionParams) -> Workload:
    """Detection from an image file, stage by stage."""

    def detect() -> tuple[int | None, dict[str, float]]:
        trace = elf.trace(file, params=params)
        return len(trace.features), trace.seconds

    return Workload("elf", "ELF, decode to descriptors", detect)


def saliencies(elf: ElfRuntime, twin: ElfRuntime | None, image: Image) -> list[Workload]:
    """The saliency map alone, at full resolution: the model's, and that of its `twin` whose weights torch has."""
    found = []
    for name, model in (("elf_saliency", elf), ("elf_saliency_twin", twin)):
        if model is not None:
            title = f"ELF saliency alone, {model.contract.precision}"
            found.append(Workload(name, title, _map_only(partial(model.saliency, scale=1.0), image)))
    return found


def peers(names: Sequence[str], image: Image, torch_saliency: Callable[[Image], Any] | None) -> list[Workload]:
    """The peers among `names`: OpenCV's on the grey image, torch's autograd saliency on the colour one."""
    found = []
    if "torch" in names and torch_saliency is not None:
        found.append(Workload("torch", "torch autograd, the saliency in fp32", _map_only(torch_saliency, image)))
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    for name in ("sift", "orb"):
        if name in names:
            detector = getattr(cv2, f"{name.upper()}_create")(PEER_KEYPOINTS)
            title = f"OpenCV {name.upper()}, at most {PEER_KEYPOINTS} keypoints"
            found.append(Workload(name, title, _opencv(detector, gray)))
    return found


def _map_only(saliency: Callable[[Image], Any], image: Image) -> Callable[[], tuple[None, dict[str, float]]]:
    def run() -> tuple[None, dict[str, float]]:
        saliency(image)
        return None, {}

    return run


def _opencv(detector: Any, gray: Any) -> Callable[[], tuple[int | None, dict[str, float]]]:
    return lambda: (len(detector.detectAndCompute(gray, None)[0]), {})


def float_model(model: str | None, torch_model: str | None) -> str:
    """The file whose weights torch takes: the one that is given, else the model, else the bundled one in fp32."""
    return torch_model or model or str(bundled_model("fp32"))


def torch_peer(model: str, threads: int) -> tuple[Callable[[Image], Any] | None, str]:
    """The saliency in torch, as `elf_export.sources.torch_saliency` rebuilds it from the model, or why there is none.

    The exporter is asked for by name and only here: the runtime neither needs nor imports it, or torch.
    """
    if is_ort_format(model):
        return None, f"{model} is in ORT format; give the .onnx file that it was made from as --torch-model"
    try:
        reference = importlib.import_module("elf_export.sources.torch_saliency")
        torch = importlib.import_module("torch")
    except ImportError as error:
        return None, f"not installed ({error.name})"
    torch.set_num_threads(threads)
    try:
        return reference.load(model), f"torch {torch.__version__}"
    except Exception as error:  # the exporter's errors can't be named here
        return None, str(error)


def synthetic(height: int, width: int, seed: int = 0) -> Image:
    """A textured image from a fixed seed: noise of several scales, under rectangles and discs.

    Returns
    -------
    (height, width, 3) uint8, BGR
    """
    rng = np.random.default_rng(seed)
    total = np.zeros((height, width, 3), np.float32)
    for cell, weight in ((64, 1.0), (16, 0.6), (4, 0.35)):
        coarse = rng.standard_normal((height // cell + 2, width // cell + 2, 3)).astype(np.float32)
        total += weight * cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    image: Image = np.clip(128 + 40 * total, 0, 255).astype(np.uint8)
    for _ in range(max(8, height * width // 4000)):
        x, y = int(rng.integers(0, width)), int(rng.integers(0, height))
        w, h = (int(v) for v in rng.integers(6, 60, 2))
        color = tuple(int(v) for v in rng.integers(0, 256, 3))
        if rng.random() < 0.7:
            cv2.rectangle(image, (x, y), (x + w, y + h), color, -1)
        else:
            cv2.circle(image, (x, y), w // 2, color, -1, cv2.LINE_AA)
    return image
