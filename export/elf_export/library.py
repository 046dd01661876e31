"""The exporter as a library: the two functions that make a request, and have it done."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Literal

from .compression.ranks import Compression
from .descriptors.projection import Reduction
from .detection import Wanted, as_mapping
from .errors import ExportError
from .pipeline import ExportResult, export
from .preprocessing import Preprocessing
from .request import Log, Request


def export_network(
    name: str,
    layer: str | None = None,
    descriptors: Sequence[str] | None = None,
    output: str | os.PathLike[str] | None = None,
    *,
    weights: str | os.PathLike[str] | None = None,
    opset: int | None = None,
    force: bool = False,
    offline: bool = False,
    detection: Wanted = None,
    preprocessing: Preprocessing | Literal["paper", "own"] = "paper",
    desc_weights: str | os.PathLike[str] | None = None,
    pool: str = "max",
    desc_scale: float = 1.0,
    reduction: Reduction | None = None,
    compression: Compression | None = None,
    calibration: str | os.PathLike[str] | None = None,
    precision: str = "fp32",
    lowering: str = "fast",
    log: Log = lambda _: None,
) -> ExportResult:
    """Export a named network as an ELF model.

    Parameters
    ----------
    name : str
        As ``elf-export --list`` shows them.
    layer, descriptors : optional
        The paper's by default; an empty sequence makes a detector without descriptors.  ``vgg:pool3`` describes
        by a layer of another network, which comes into the same file.
    output : path, optional
        ``elf-NAME-LAYER.onnx`` by default.
    weights : path, optional
        The published ones by default: see `elf_export.sources.weights.load.load_weights`.
    opset : int, optional
        11 to 20, 17 by default.
    force : bool
        Overwrite an existing file.
    offline : bool
        Don't try the network for weights.
    detection : DetectionParams or dict, optional
        The settings that the runtime uses where the caller gives none, or what to change of the network's own.
    preprocessing : "paper", "own" or Preprocessing
        For the detector: the paper's standardisation, what the network was trained with, or any other.
    desc_weights : path, optional
        Weights of the other network that describes, as `weights`.
    pool : "max" or "average"
        "average": the detector averages where the network takes maxima; layers that describe keep their pooling.
    desc_scale : float
        Share of the height and width of the detector's image at which the describing layers see it; the graph resizes.
    reduction : Reduction, optional
        Fewer values a descriptor, in every descriptor layer; the layers' channels as they are by default.
    compression : Compression, optional
        Convolutions in low rank, for less time: see `elf_export.compression`.
    calibration : path, optional
        Folder of images that compression, reduction and precision are fitted to; the exporter's photographs by default.
    precision : "fp32", "fp16", "bf16" or "int8"
        See `elf_export.precision.lower`.
    lowering : "fast" or "plain"
        How the gradient is written: in the form that is fast in the precision, or with nothing clever.
    log : function
        Is told of each step in a line or a table.

    Returns
    -------
    ExportResult

    Raises
    ------
    ExportError
        Unknown network, layer or opset, missing weights, an existing file, a calibration image that can't be
        used, a graph that does not agree with torch.autograd, or one that the runtime would refuse; no file is left
        behind.
    """
    desc = None if descriptors is None else tuple(descriptors)
    return export(
        Request(
            net=name, layer=layer, desc=desc, output=output, weights=weights, desc_weights=desc_weights,
            offline=offline, preprocess=preprocessing, opset=opset, force=force, detection=as_mapping(detection),
            pool=pool, desc_scale=desc_scale, reduction=reduction, compression=compression,
            calibration=calibration, precision=precision, lowering=lowering,
        ),
        log,
    )  # fmt: skip


def export_onnx(
    file: str | os.PathLike[str],
    layer: str,
    descriptors: Sequence[str],
    output: str | os.PathLike[str] | None = None,
    *,
    image_input: str | None = None,
    preprocessing: Preprocessing | None = None,
    opset: int | None = None,
    force: bool = False,
    offline: bool = False,
    detection: Wanted = None,
    desc_weights: str | os.PathLike[str] | None = None,
    pool: str = "max",
    desc_scale: float = 1.0,
    reduction: Reduction | None = None,
    compression: Compression | None = None,
    calibration: str | os.PathLike[str] | None = None,
    precision: str = "fp32",
    lowering: str = "fast",
    log: Log = lambda _: None,
) -> ExportResult:
    """Export any CNN's .onnx file as an ELF model; needs no torch, unless a named network describes.

    Parameters
    ----------
    layer, descriptors : names
        Of values or nodes, or unique ends of them; no descriptors make a detector.  ``vgg:pool3`` describes by a layer
        of a named network, which comes into the same file.
    output : path, optional
        ``elf-FILE-LAYER.onnx`` by default.
    image_input : str, optional
        Name of the image input, where several may be one.
    preprocessing : Preprocessing, optional
        By default the paper's standardisation, on RGB (or gray) pixels.
    opset : int, optional
        The file's own by default, moved into 11 to 20.
    offline, desc_weights, detection, pool, desc_scale, reduction, compression, calibration : optional
        As in `export_network`.
    precision, lowering, log : optional
        As in `export_network`.

    Returns
    -------
    ExportResult

    Raises
    ------
    ExportError
        A file that can't be read or run, an unknown layer, a working scale for a model of one size, a calibration
        image that can't be used, an op without an adjoint, a gradient that does not agree with central differences, or
        a file that the runtime would refuse; none is left behind.
    """
    if descriptors is None:
        raise ExportError("descriptors are names of layers, or an empty list for a detector without any")
    return export(
        Request(
            onnx=file, layer=layer, desc=tuple(descriptors), output=output, desc_weights=desc_weights, offline=offline,
            preprocess=preprocessing, input=image_input, opset=opset, force=force, detection=as_mapping(detection),
            pool=pool, desc_scale=desc_scale, reduction=reduction, compression=compression,
            calibration=calibration, precision=precision, lowering=lowering,
        ),
        log,
    )  # fmt: skip
