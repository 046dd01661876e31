"""The machine and the versions that timings depend on."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnxruntime as ort

import elf_runtime


def environment(threads: int, provider: str) -> dict[str, Any]:
    """The machine and the versions that timings depend on."""
    affinity = getattr(os, "sched_getaffinity", None)
    load = getattr(os, "getloadavg", None)
    return {
        "cpu": _cpu_name(),
        "cores": os.cpu_count(),
        "usable_cores": usable_cores() if affinity else None,
        "load_average": round(load()[0], 2) if load else None,
        "threads": threads,
        "platform": platform.platform(),
        "python": platform.python_version(),
        "elf_runtime": elf_runtime.__version__,
        "onnxruntime": ort.__version__,
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "provider": provider,
        "providers_installed": ort.get_available_providers(),
    }


def usable_cores() -> int:
    """Cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def _cpu_name() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
