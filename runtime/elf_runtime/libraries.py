"""Load OpenCV and ONNX Runtime, or say what to install.  ONNX Runtime's telemetry is switched off.

The package imports this module before its others, and elf_export and elf_eval import the package first.  So ONNX
Runtime is loaded here, with its telemetry off, whoever imports it afterwards.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType

TELEMETRY = "ORT_DISABLE_TELEMETRY"  # ONNX Runtime 1.29 and later read it once, while they are loaded
WANTED = ("0", "false", "no", "off")  # values of it by which the user asks for telemetry


@dataclass(frozen=True)
class Library:
    """A library that comes in several builds, each of them a package of its own that holds the same module.

    Attributes
    ----------
    part : str
        A name in the module of every build.  The empty folder that stays when one of two builds is removed lacks it.
    """

    module: str
    title: str
    package: str
    others: str
    part: str

    def load(self) -> ModuleType:
        """Import it.

        Raises
        ------
        ImportError
            If it is not installed, or only in parts, or can't be loaded; with what to install.
        """
        try:
            loaded = import_module(self.module)
        except Exception as error:  # half-replaced builds raise AttributeError, some RuntimeError
            if isinstance(error, ModuleNotFoundError) and error.name == self.module:
                text = f"is not installed: pip install {self.package}, {self.others}"
            else:
                reason = " ".join(str(error).split()) or type(error).__name__
                text = f"is installed but can't be loaded ({reason}): {self._again}"
        else:
            if hasattr(loaded, self.part):
                return loaded
            text = f"is installed in parts only, as when one of two builds was removed: {self._again}"
        raise ImportError(f"elf_runtime needs {self.title}, which {text}", name=self.module) from None

    @property
    def _again(self) -> str:
        return f"pip install --force-reinstall {self.package}, {self.others}"


OPENCV = Library(
    "cv2", "OpenCV (cv2)", "opencv-python-headless", "or opencv-python where its windows are wanted", "imread"
)
ONNXRUNTIME = Library(
    "onnxruntime",
    "ONNX Runtime (onnxruntime)",
    "onnxruntime",
    "or the build for your device, such as onnxruntime-gpu or onnxruntime-openvino",
    "InferenceSession",
)


def prepare() -> None:
    """Load both, with ONNX Runtime's telemetry off unless the environment asks for it.

    Child processes inherit the variable.  An ONNX Runtime that was loaded before, or does not read it, is told through
    its interface.
    """
    value = os.environ.get(TELEMETRY) or "1"
    os.environ[TELEMETRY] = value
    OPENCV.load()
    loaded = ONNXRUNTIME.load()
    if value.lower() not in WANTED and hasattr(loaded, "disable_telemetry_events"):
        loaded.disable_telemetry_events()


prepare()
