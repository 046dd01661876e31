"""The request that elf-export's options make."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from elf_export.request import Request

if TYPE_CHECKING:
    from elf_export.compression.ranks import Compression
    from elf_export.descriptors.projection import Reduction
    from elf_export.end_to_end.build import Form
    from elf_export.preprocessing import Preprocessing


def request_of(args: argparse.Namespace) -> Request:
    """What the options ask for."""
    desc = layers_of(args.desc)
    return Request(
        net=args.net,
        onnx=args.onnx,
        layer=args.layer,
        desc=None if desc is None else tuple(desc),
        output=args.output,
        weights=args.weights,
        desc_weights=args.desc_weights,
        offline=args.offline,
        preprocess=preprocessing_of(args) if args.net is None else args.preprocess or "paper",
        pool=args.pool,
        desc_scale=1.0 if args.desc_scale is None else args.desc_scale,
        input=args.input,
        opset=args.opset,
        force=args.force,
        detection=dict(args.set),
        reduction=reduction_of(args),
        compression=compression_of(args),
        calibration=args.calibration,
        precision=args.precision,
        lowering=args.lowering,
        end_to_end=form_of(args),
    )


def preprocessing_of(args: argparse.Namespace) -> Preprocessing | None:
    """What --color, --mean, --std, --scale and --standardize say; None where they say nothing."""
    from elf_export.preprocessing import Preprocessing

    stated = [value is not None for value in (args.mean, args.std, args.scale)]
    if not any(stated) and args.color is None and not args.standardize:
        return None
    return Preprocessing(
        color=args.color or "rgb",
        standardize=not any(stated),
        scale=1.0 if args.scale is None else args.scale,
        mean=args.mean or (0.0,),
        std=args.std or (1.0,),
    )


def reduction_of(args: argparse.Namespace) -> Reduction | None:
    """What --desc-dim, --desc-reduce and --whiten say; None without --desc-dim."""
    from elf_export.descriptors.projection import Reduction

    if args.desc_dim is None:
        return None
    return Reduction(args.desc_dim, args.desc_reduce or "pca", args.whiten, args.keep_weights)


def compression_of(args: argparse.Namespace) -> Compression | None:
    """What --compress says; None without it."""
    from elf_export.compression.ranks import Compression

    return None if args.compress is None else Compression.parse(args.compress)


def form_of(args: argparse.Namespace) -> Form | None:
    """What --end-to-end and --rounds say; None without the first."""
    from elf_export.end_to_end.build import Form

    if args.end_to_end is None:
        return None
    pixels = "float32" if "float32" in args.end_to_end else "uint8"
    color = "rgb" if "rgb" in args.end_to_end else "bgr"
    kinds = {word: word in args.end_to_end for word in ("batch", "saliency", "required", "opencv")}
    return Form(pixels, color, rounds=args.rounds, **kinds)


def layers_of(text: str | None) -> list[str] | None:
    """--desc as a list: None where it is not given, empty for "none"."""
    if text is None:
        return None
    return [] if text == "none" else [name.strip() for name in text.split(",") if name.strip()]
