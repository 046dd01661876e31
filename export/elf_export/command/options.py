"""elf-export's options."""

from __future__ import annotations

import argparse
from fractions import Fraction

from elf_export.request import LOWERINGS, POOLS, PRECISIONS
from elf_runtime.commands.options import add_quiet, from_zero, setting
from elf_runtime.commands.parser import Parser, new_parser

DESCRIPTION = """\
Write one .onnx file that computes a CNN's saliency |F^T dF/dI| (the backward pass is in the graph) and its descriptor
maps; elf_runtime finds keypoints with it, without PyTorch."""

EPILOG = """\
examples:
  elf-export --net vgg --layer pool2                     the paper's detector, described by pool4
  elf-export --net vgg --layer pool1 --desc conv3_2      a cheaper one
  elf-export --net vgg --layer pool1 --desc conv3_2 --desc-dim 128
                                                         described by 128 principal components
  elf-export --net vgg --layer pool2 --desc none         saliency and keypoints only
  elf-export --net superpoint --desc vgg:pool3 --weights superpoint_v1.pth
                                                         SuperPoint detects, VGG describes
  elf-export --net vgg --list                            the layers to choose from
  elf-export --onnx model.onnx --list                    the layers of anyone's model
  elf-export --onnx model.onnx --layer relu2 --desc relu4
                                                         an ELF model from it; needs no PyTorch
"""


def parser() -> Parser:
    """The command line's grammar."""
    p = new_parser("elf-export", DESCRIPTION, EPILOG)
    p.add_argument("--layer", metavar="LAYER", help="the layer F that keypoints come from (--net: the paper's)")
    _describing(p)
    _file(p)
    _named_network(p.add_argument_group("a network that comes with the exporter"))
    _anyones_model(
        p.add_argument_group(
            "anyone's model",
            "Layers are named by value or node, or by an end of such a name that only one has.  The pixels I, 0..255, "
            "become (I * scale - mean) / std; without these options the model sees them standardized.",
        )
    )
    return p


def _describing(p: argparse.ArgumentParser) -> None:
    p.add_argument(
        "--desc", metavar="LAYER[,LAYER...]|none",
        help="layers that describe the keypoints, the first being the default; NET:LAYER takes one of another network "
        "that comes with the exporter (--net: the paper's)",
    )  # fmt: skip
    p.add_argument(
        "--desc-scale", type=number, metavar="R",
        help="let the layers of --desc see the image at R of the height and width at which the detector sees it, a "
        "number or a fraction: the graph resizes it (default: 1)",
    )  # fmt: skip
    p.add_argument(
        "--desc-dim", type=int, metavar="D",
        help="values of a descriptor: each layer of --desc is projected to so many inside the graph (default: its "
        "channels as they are)",
    )  # fmt: skip
    p.add_argument(
        "--desc-reduce", choices=("pca", "channels"),
        help="how --desc-dim projects: to the principal components of the layer's channels over the calibration "
        "images (pca, the default), or to the channels that vary most",
    )  # fmt: skip
    p.add_argument(
        "--whiten",
        type=float,
        metavar="A",
        help="with pca: divide each component by its variance to the power of A / 2; 0, not at all, to 1 (default: "
        "0.75)",
    )
    p.add_argument(
        "--keep-weights", action="store_true",
        help="project by a convolution of its own: the layer's weights stay in the file as they were trained, for "
        "other exports to find",
    )  # fmt: skip


def _file(p: argparse.ArgumentParser) -> None:
    p.add_argument(
        "--calibration",
        metavar="FOLDER",
        help="images that --compress, --desc-dim and --precision are fitted to (default: photographs that come with "
        "the exporter)",
    )
    p.add_argument(
        "--compress", metavar="RATIO|energy=E|LAYER=RANK,...",
        help="convolutions in low rank, for less time: to a ratio of their multiply-adds (0.5), to a share of the "
        "variance of what each gives (energy=0.99), or to so many channels between the two parts of each that is named "
        "(conv1_2=16,conv2_1=32).  What it changes is printed",
    )  # fmt: skip
    p.add_argument(
        "--precision", choices=PRECISIONS, default="fp32",
        help="int8: convolutions in 8-bit integers, for CPUs; fp16: for GPUs; bf16: weights stored in half the bytes. "
        "What it changes against fp32 is printed",
    )  # fmt: skip
    p.add_argument(
        "--lowering", choices=LOWERINGS, default="fast",
        help="how the gradient is written: in the form that is fast in the precision (default), or with nothing clever "
        "(plain; not int8), to be read and for runtimes that stumble over the fast one; the values are the same",
    )  # fmt: skip
    p.add_argument(
        "--end-to-end", nargs="*",
        choices=("uint8", "float32", "bgr", "rgb", "batch", "saliency", "required", "opencv"),
        help="put all that follows the network into the graph too: an image goes in, of bytes (uint8, the default) or "
        "floats in 0..255, BGR as OpenCV's (the default) or rgb, and keypoints, scores and descriptors come out, in "
        "any ONNX runtime; batch: several images of one size at once; saliency: its map comes out "
        "too; required: max_keypoints, threshold and mask have no defaults, for OpenVINO and onnxruntime-web, which "
        "take these for constants; opencv: for OpenCV 5's cv2.dnn, with --rounds",
    )  # fmt: skip
    p.add_argument(
        "--rounds", type=from_zero, default=0, metavar="N",
        help="with --end-to-end: unroll N rounds of the suppression, for runtimes without Loop and If (default: 0, a "
        "Loop of as many as it takes)",
    )  # fmt: skip
    p.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", type=setting,
        help="a detection setting that the file carries as its default, such as scale=0.5 or denoise=5,1.2; may be "
        "given several times",
    )  # fmt: skip
    p.add_argument(
        "--pool", choices=POOLS, default="max",
        help="average: the detector averages where the network takes maxima; keypoints then stay where they are when "
        "the image moves by a pixel.  Layers that describe keep their pooling",
    )  # fmt: skip
    p.add_argument(
        "--match", action="store_true",
        help="make the matching instead, for the descriptors of --end-to-end: mutual nearest neighbours with a ratio "
        "test, in a small file of its own",
    )  # fmt: skip
    p.add_argument(
        "--elf", metavar="FILE",
        help="an ELF model that is there, or int8 or fp32 for the bundled one: --end-to-end is put into it, without "
        "PyTorch",
    )  # fmt: skip
    p.add_argument(
        "--output", "-o", metavar="FILE", help="default: elf-NET-LAYER.onnx, elf-match.onnx or elf-alone.onnx"
    )
    p.add_argument("--opset", type=int, metavar="N", help="ONNX opset of the file, 11 to 20 (default: 17; with "
                   "--onnx the model's own, if it is one of these)")  # fmt: skip
    p.add_argument("--force", action="store_true", help="overwrite an existing file")
    add_quiet(p)
    p.add_argument("--list", action="store_true", help="list the networks, or the layers of one, and stop")
    p.add_argument("--desc-weights", metavar="FILE", help="weights of the other network of --desc NET:LAYER")
    p.add_argument("--offline", action="store_true", help="never use the network; so does ELF_OFFLINE=1")


def _named_network(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--net", metavar="NAME", help="--list shows the names")
    group.add_argument(
        "--weights", metavar="FILE",
        help="trained weights: .pth, .h5, .keras, .safetensors, .npz, .index (TensorFlow) or .onnx (default: "
        "the published ones, from the cache, the bundled model, the publisher or a package index)",
    )  # fmt: skip
    group.add_argument(
        "--preprocess", choices=("paper", "own"),
        help="what the detector is fed: each image standardised (paper, the default), or what it was trained with",
    )  # fmt: skip


def _anyones_model(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--onnx", metavar="FILE", help="a CNN in ONNX's format, from any framework")
    group.add_argument("--input", metavar="NAME", help="the image input, where several may be one")
    group.add_argument("--color", choices=("bgr", "rgb", "gray"), help="default: rgb, or gray for one channel")
    group.add_argument("--scale", type=number, metavar="S", help="a number or a fraction like 1/255 (default: 1)")
    group.add_argument("--mean", type=numbers, metavar="M[,M,M]", help="per channel, of the scaled pixels (default: 0)")
    group.add_argument("--std", type=numbers, metavar="D[,D,D]", help="per channel, of the scaled pixels (default: 1)")
    group.add_argument("--standardize", action="store_true",
                      help="(I - mean(I)) / std(I) over each image, as in the paper")  # fmt: skip


def number(text: str) -> float:
    """A number or a fraction: "0.5", "1/255"."""
    try:
        return float(Fraction(text.strip()))
    except (ValueError, ZeroDivisionError):
        raise argparse.ArgumentTypeError(f"{text!r} is neither a number nor a fraction like 1/255") from None


def numbers(text: str) -> tuple[float, ...]:
    """One number for all channels, or one for each, separated by commas."""
    values = tuple(number(part) for part in text.split(","))
    if len(values) not in (1, 3):
        raise argparse.ArgumentTypeError(f"{text!r} has {len(values)} numbers; give one, or one a channel")
    return values
