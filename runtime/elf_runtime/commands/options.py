"""The options that commands share: model, images and detection settings, and what they stand for."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_runtime.engine import ElfRuntime
from elf_runtime.errors import SettingError, suggestion
from elf_runtime.image.file import MAX_PIXELS, read
from elf_runtime.model.providers import Provider
from elf_runtime.params import SETTINGS, DetectionParams, parse_setting, parse_value, setting_text, setting_value
from elf_runtime.presets import PRESETS

from .command import UsageError


def add_model_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("model")
    group.add_argument("--model", metavar="FILE", help="ELF model that elf-export wrote; default: the bundled one")
    add_provider(group, "ONNX Runtime execution provider: cpu (default), cuda, openvino, ...")
    group.add_argument("--threads", type=positive, metavar="N", help="threads of the network; default: one per core")


def add_provider(parser: argparse._ActionsContainer, what: str) -> None:
    """The options that `provider` reads."""
    parser.add_argument("--provider", metavar="NAME", help=what)
    parser.add_argument(
        "--provider-option", "--option", action="append", default=[], type=key_and_value, metavar="KEY=VALUE",
        help="an option of that provider, as ONNX Runtime names it; may be given several times",
    )  # fmt: skip


def provider(args: argparse.Namespace) -> Provider | None:
    """The provider that is asked for, with its options; None where none is.

    Raises
    ------
    UsageError
        On options without a provider.
    """
    if not args.provider_option:
        return None if args.provider is None else str(args.provider)
    if args.provider is None:
        raise UsageError("--provider-option is for the provider that --provider names")
    return args.provider, dict(args.provider_option)


def add_quiet(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-q", "--quiet", action="store_true", help="say nothing but errors")


def add_detection_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        "detection",
        "Lengths are in pixels of the source image. What is not given is the preset's, else the model's.",
    )
    group.add_argument("--max-keypoints", type=int, metavar="N", help="keep the N strongest keypoints")
    group.add_argument(
        "--threshold",
        type=parse_value,
        metavar="T",
        help="'kapur': maximum-entropy level of the blurred saliency; 'none'; or a fixed level in [0, 1]",
    )
    group.add_argument(
        "--nms-radius",
        type=int,
        metavar="R",
        help="a keypoint suppresses weaker ones within R pixels in x and y, to the nearest pixel at the working scale",
    )
    group.add_argument("--border", type=int, metavar="B", help="no keypoints within B pixels of the image's edges")
    group.add_argument(
        "--grid", type=grid, metavar="RxC",
        help="spread keypoints over R x C cells of the image, an equal share each",
    )  # fmt: skip
    group.add_argument(
        "--preset", choices=PRESETS,
        help="fast, default (the model's own), accurate, multiscale, or settings of the ELF paper's experiments",
    )  # fmt: skip
    group.add_argument("--scale", type=float, metavar="S", help="resize the image by S for the network (0.5 = half)")
    group.add_argument(
        "--max-side", type=positive, metavar="N",
        help="longest side that the network sees, in pixels: larger images at a smaller scale, in less time and memory",
    )  # fmt: skip
    group.add_argument("--descriptor", metavar="LAYER", help="which of the model's descriptors (see elf-info)")
    add_set_option(group)


def add_set_option(group: argparse._ActionsContainer) -> None:
    group.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", type=setting,
        help=f"any setting, such as normalize=0.95 or denoise=5,1.2; may be given several times. NAME is one of "
        f"{', '.join(SETTINGS)}",
    )  # fmt: skip


def add_image_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--ignore-exif",
        action="store_true",
        help="take images as they are stored, as COLMAP does; by default they are turned as their EXIF orientation "
        "says, and keypoints are in the turned image (OpenCV turns TIFF files in any case)",
    )
    add_max_pixels_option(parser)


def add_max_pixels_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--max-pixels", type=positive, default=MAX_PIXELS, metavar="N",
        help=f"refuse image files of more pixels before decoding them; default: {MAX_PIXELS:,}",
    )  # fmt: skip


def add_mask(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--mask", metavar="FILE",
        help="image of the same size: keypoints only where it is not black, and away from its edge (see mask_border)",
    )  # fmt: skip


def read_mask(args: argparse.Namespace) -> npt.NDArray[np.bool_] | None:
    """(H, W), of --mask: a colour is black where all of its parts are, and what alpha leaves out is; None without."""
    if args.mask is None:
        return None
    mask = read_image(args.mask, args)
    return np.asarray(mask > 0 if mask.ndim == 2 else mask[:, :, :3].any(axis=2) & (mask[:, :, 3:] > 0).all(axis=2))


def read_image(path: str | Path, args: argparse.Namespace) -> npt.NDArray[Any]:
    """The pixels of a file, as `image.read`, by the options of `add_image_options`."""
    return read(path, ignore_exif=args.ignore_exif, max_pixels=args.max_pixels)


def settings(args: argparse.Namespace) -> dict[str, Any]:
    """The detection options as `ElfRuntime.trace` takes them.

    Raises
    ------
    UsageError
        On a --set of an unknown name, or of one that has an option which is given too.
    SettingError
        On several values where others are expected.
    """
    own_options = (
        "max_keypoints", "threshold", "nms_radius", "border", "grid", "preset", "scale", "max_side", "descriptor",
    )  # fmt: skip
    given = {name: getattr(args, name) for name in own_options}
    for name, _ in args.set:
        if name not in SETTINGS:
            near = suggestion(name, SETTINGS)
            raise UsageError(f"--set: unknown setting {name!r}; known are {', '.join(SETTINGS)}{near}")
        if given.get(name) is not None:
            raise UsageError(f"--set {name}: --{name.replace('_', '-')} is given too; leave one of them out")
    found = given | dict(args.set)
    for name, value in found.items():
        if name in SETTINGS and isinstance(value, tuple):
            setting_value(name, setting_text(value))  # its error shows the text, not a tuple
    return found


def params(elf: ElfRuntime, args: argparse.Namespace) -> DetectionParams:
    """What the detection options amount to.

    Raises
    ------
    UsageError, SettingError
        See `settings`; a value out of range.
    """
    given = settings(args)
    return elf.params(given.pop("preset"), **{name: value for name, value in given.items() if name != "descriptor"})


def origin(elf: ElfRuntime, args: argparse.Namespace) -> dict[str, Any]:
    """Which model, provider and settings results come from, as plain data."""
    contract = elf.contract
    spec = contract.descriptor(args.descriptor)
    return {
        "model": args.model or "bundled",
        "model_sha256": elf.sha256,
        "network": contract.network,
        "layer": contract.layer,
        "descriptor": spec.layer if spec else None,
        "provider": elf.providers[0],
        "settings": params(elf, args).to_dict(),
    }


def open_runtime(args: argparse.Namespace) -> ElfRuntime:
    """The model of the options, with detection settings checked before the first image is read."""
    elf = ElfRuntime(args.model, providers=provider(args), threads=args.threads, max_pixels=args.max_pixels)
    params(elf, args)
    elf.contract.descriptor(args.descriptor)
    return elf


def positive(text: str) -> int:
    """An argparse type: a whole number from 1 on."""
    if re.fullmatch("0*[1-9][0-9]*", text) is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 on")
    return int(text)


def from_zero(text: str) -> int:
    """An argparse type: a whole number from 0 on."""
    if re.fullmatch("[0-9]+", text) is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 on")
    return int(text)


def key_and_value(text: str) -> tuple[str, str]:
    """An argparse type: ``KEY=VALUE``."""
    key, separator, value = text.partition("=")
    if not (key and separator):
        raise argparse.ArgumentTypeError(f"{text!r} is not KEY=VALUE")
    return key, value


def setting(text: str) -> tuple[str, Any]:
    """An argparse type: ``NAME=VALUE``, as `parse_setting`."""
    try:
        return parse_setting(text)
    except SettingError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def grid(text: str) -> tuple[int, int]:
    """An argparse type: ``4x6``, rows and columns."""
    match = re.fullmatch("(0*[1-9][0-9]*)x(0*[1-9][0-9]*)", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not ROWSxCOLUMNS")
    return int(match[1]), int(match[2])
