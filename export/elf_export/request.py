"""What an export is asked for, by the command line or by the library; nothing here needs the onnx package."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from elf_runtime.params import setting_text
from elf_runtime.values import is_number

from .errors import ExportError

if TYPE_CHECKING:
    from .compression.ranks import Compression
    from .descriptors.projection import Reduction
    from .end_to_end.build import Form
    from .preprocessing import Preprocessing

POOLS = ("max", "average")
DESC_SCALES = (0.125, 4.0)
PRECISIONS = ("fp32", "fp16", "bf16", "int8")
LOWERINGS = ("fast", "plain")
LEAST_OPSET = 13  # of all but fp32: bfloat16, and one scale for each channel, are of that opset

File = str | os.PathLike[str]
Log = Callable[[str], None]
"""Is told of each step in a line or a table."""


@dataclass(frozen=True)
class Request:
    """An export, as `elf-export`'s options say it; exactly one of `net` and `onnx` is given.

    A source completes it: with the layers by their full names, say, and without weights that are found anyway.  The
    command that `words` gives then makes the same file again.

    Attributes
    ----------
    net : str
        A named network.
    onnx : path
        Anyone's model.
    layer : str, optional
        F; a named network has the paper's by default.
    desc : tuple of str, optional
        Layers to describe by, the first being the default; ``NET:LAYER`` is another network's.  None: the paper's.
    output : path, optional
        ``elf-NETWORK-LAYER.onnx`` by default.
    weights, desc_weights : path, optional
        Of the named network, and of the other one that describes.
    preprocess : "paper", "own" or Preprocessing, optional
        What the detector is fed: each image standardised (the paper's, and the default), or what it was trained with.
    pool : "max" or "average"
        What the detector's max-pooling is; layers that describe keep theirs.
    desc_scale : float
        At which share of the height and width of the image that the detector sees the describing layers see it.
    input : str, optional
        The image input of `onnx`, where several may be one.
    opset : int, optional
        17 for a named network by default, the model's own for another.
    detection : mapping
        Settings that the file carries in place of the network's own.
    reduction : Reduction, optional
        Fewer values a descriptor.
    compression : Compression, optional
        Convolutions in low rank.
    calibration : path, optional
        Folder of images that compression, reduction and precision are fitted to.
    lowering : "fast" or "plain"
        How the gradient is written: in the form that is fast in the precision, or with nothing clever.
    end_to_end : Form, optional
        Keypoints in place of maps: the post-processing in the graph, in this form.
    """

    net: str | None = None
    onnx: File | None = None
    layer: str | None = None
    desc: tuple[str, ...] | None = None
    output: File | None = None
    weights: File | None = None
    desc_weights: File | None = None
    offline: bool = False
    preprocess: Preprocessing | Literal["paper", "own"] | None = None
    pool: str = "max"
    desc_scale: float = 1.0
    input: str | None = None
    opset: int | None = None
    force: bool = False
    detection: Mapping[str, Any] = field(default_factory=dict)
    reduction: Reduction | None = None
    compression: Compression | None = None
    calibration: File | None = None
    precision: str = "fp32"
    lowering: str = "fast"
    end_to_end: Form | None = None

    def __post_init__(self) -> None:
        if (self.net is None) == (self.onnx is None):
            raise ExportError("an export is of a named network or of an .onnx file: give one of the two")
        if self.pool not in POOLS:
            raise ExportError(f"pooling is one of {', '.join(POOLS)}, not {self.pool!r}")
        if self.lowering not in LOWERINGS:
            raise ExportError(f"the lowering is one of {', '.join(LOWERINGS)}, not {self.lowering!r}")
        if self.lowering == "plain" and self.precision == "int8":
            raise ExportError("8 bits gain in a form of their own only: --lowering plain is for fp32, fp16 and bf16")
        least, most = DESC_SCALES
        if not (is_number(self.desc_scale) and least <= self.desc_scale <= most):
            raise ExportError(f"the descriptors' scale is a number from {least:g} to {most:g}, not {self.desc_scale!r}")
        if self.desc_scale != 1.0 and self.desc == ():
            raise ExportError(f"a descriptors' scale of {self.desc_scale:g}, and no layer that describes")
        if not isinstance(self.detection, Mapping):
            raise ExportError(f"detection settings are a DetectionParams or a dict, not {self.detection!r}")
        if self.reduction is not None and not hasattr(self.reduction, "words"):
            raise ExportError(f"descriptors are reduced by a Reduction, such as Reduction(128), not {self.reduction!r}")

    def words(self) -> list[str]:
        """The command that asks for the same file.

        Models and weights are named without their folders, which are one machine's.  No command can say a layer with a
        comma in its name, nor a `Preprocessing` for a named network.
        """
        words = ["elf-export"]

        def option(name: str, value: object) -> None:
            text = str(value) if value else ""
            words.extend([f"--{name}={text}"] if text.startswith("-") else [f"--{name}", text] if text else [])

        option("net", self.net)
        option("onnx", _name(self.onnx))
        option("weights", _name(self.weights))
        option("desc-weights", _name(self.desc_weights))
        option("input", self.input)
        option("opset", self.opset)
        option("layer", self.layer)
        if self.desc is not None:
            option("desc", ",".join(self.desc) or "none")
        if self.preprocess == "own":
            option("preprocess", "own")
        option("pool", self.pool if self.pool != "max" else "")
        option("desc-scale", f"{self.desc_scale!r}" if self.desc_scale != 1.0 else "")
        words += self.reduction.words() if self.reduction is not None else []
        words += self.compression.words() if self.compression is not None else []
        for name, value in self.detection.items():
            words += ["--set", f"{name}={setting_text(value)}"]
        option("precision", self.precision if self.precision != "fp32" else "")
        option("lowering", self.lowering if self.lowering != "fast" else "")
        words += self.end_to_end.words() if self.end_to_end is not None else []
        if self.reduction is not None or self.compression is not None or self.precision != "fp32":
            option("calibration", self.calibration)
        if self.onnx is not None and self.preprocess not in (None, "paper", "own"):
            words += self.preprocess.words()  # type: ignore[union-attr]
        return words


def check_precision(precision: str, opset: int) -> None:
    """Raise ExportError on an unknown precision, or an opset too old for it."""
    if precision not in PRECISIONS:
        raise ExportError(f"precision is one of {', '.join(PRECISIONS)}, not {precision!r}")
    if precision != "fp32" and opset < LEAST_OPSET:
        raise ExportError(
            f"the model is of opset {opset}, {precision} needs opset {LEAST_OPSET} or later; choose one with --opset"
        )


def _name(file: File | None) -> str:
    return "" if file is None else Path(file).name
