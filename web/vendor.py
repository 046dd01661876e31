"""Put beside the page what it loads, in vendor/: ONNX Runtime, two models, two pictures and what Python finds there.

    npm install && python vendor.py

Needs elf_export; the models are the bundled ones with the settings of the preset `fast` and all steps in the graph.
"""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import onnx
import onnxruntime

from elf_export.end_to_end.build import Form, end_to_end
from elf_export.file import stamped
from elf_runtime import ElfRuntime, match, preset
from elf_runtime.model import bundled_model

HERE = Path(__file__).parent
DEMO = HERE.parent / "demo"
RUNTIME_FILES = (
    "ort.wasm.min.mjs", "ort-wasm-simd-threaded.mjs", "ort-wasm-simd-threaded.wasm",
    "ort.min.mjs", "ort-wasm-simd-threaded.jsep.mjs", "ort-wasm-simd-threaded.jsep.wasm",
)  # fmt: skip
RATIO = 0.9


def model_of(precision: str) -> bytes:
    """The bundled model with image in and keypoints, scores, descriptors and saliency out."""
    path, form = bundled_model(precision), Form(saliency=True)
    contract = replace(ElfRuntime(path).contract, detection=preset("fast"))
    whole = end_to_end(onnx.load(path), contract, form)
    return stamped(whole, replace(contract, end_to_end=form.spec, descriptors=contract.descriptors[:1]))


def expected(model: bytes, images: list[np.ndarray]) -> dict[str, object]:
    """What ONNX Runtime finds with it in Python, and the matches of the two images."""
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    found = [session.run(["keypoints", "scores", "descriptors"], {"image": image[None]}) for image in images]
    return {
        "keypoints": [np.round(keypoints.astype(float), 4).tolist() for keypoints, _, _ in found],
        "matches": match(found[0][2], found[1][2], ratio=RATIO).tolist(),
        "ratio": RATIO,
    }


def main(modules: Path, target: Path) -> int:
    source = modules / "onnxruntime-web" / "dist"
    if not source.is_dir():
        print(f"vendor: error: no onnxruntime-web in {modules}: run npm install in {HERE}", file=sys.stderr)
        return 1
    target.mkdir(parents=True, exist_ok=True)
    for name in RUNTIME_FILES:
        shutil.copyfile(source / name, target / name)
    shutil.copyfile(DEMO / "palace.jpg", target / "palace.jpg")
    sys.path.insert(0, str(DEMO))
    from second_view import second_view

    palace = cv2.imread(str(DEMO / "palace.jpg"))
    view = second_view(palace)
    cv2.imwrite(str(target / "view.png"), view)
    vectors = {}
    for precision in ("int8", "fp32"):
        model = model_of(precision)
        name = f"elf-fast-{precision}.onnx"
        (target / name).write_bytes(model)
        vectors[name] = expected(model, [palace, view])
    (target / "expected.json").write_text(json.dumps(vectors), encoding="utf-8")
    for path in sorted(target.iterdir()):
        print(f"{path.stat().st_size / 1e6:8.2f} MB  {path.name}")
    return 0


if __name__ == "__main__":
    folders = [Path(argument) for argument in sys.argv[1:3]]
    sys.exit(main(*(folders + [HERE / "node_modules", HERE / "vendor"][len(folders) :])))
