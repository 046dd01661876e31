"""What was tried of the bundled models and of end-to-end files, and when: for what is not installed here."""

from __future__ import annotations

from collections.abc import Mapping

TRIED = {
    "OpenVINOExecutionProvider": "int8 and fp32 whole on CPUs, none end-to-end; onnxruntime-openvino 1.24.1, 2026-11",
    "CUDAExecutionProvider": "never run; every op of fp32 is in its documented list, 2026-11",
    "TensorrtExecutionProvider": "never run; every op of fp32 is in its parser's documented list, 2026-11",
    "openvino": "without ONNX Runtime: end-to-end files with --rounds, in float32; openvino 2026.4.1, 2026-11",
    "onnxruntime-web": "all files in WebAssembly, fp32 in WebGPU in software; 1.30, 2026-11",
    "cv2.dnn": "int8's maps; of fp32 end-to-end files with opencv and --rounds; OpenCV 5.0.0, 2026-11 (4.12: none)",
}
"""By provider or runtime: with which version, and in which month."""


def elsewhere(installed: Mapping[str, object]) -> dict[str, str]:
    """What was tried of those that are not installed."""
    return {name: text for name, text in TRIED.items() if name not in installed}
