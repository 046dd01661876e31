"""Which of elf-export's options go together."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from .asked import layers_of
from .options import parser

ONLY_WITH_NET = ("weights", "preprocess")
ALONE = {  # what goes with an option that makes a file of no network, or of a model that is there; and why no more does
    "match": (("output", "force", "quiet"), "--match makes a file that no network is in"),
    "elf": (("end_to_end", "rounds", "set", "output", "force", "quiet"), "--elf takes an ELF model as it is"),
}
OF_NAMED_NETWORKS = ("offline", "desc_weights")  # with --net, or --desc NET:LAYER
ONLY_WITH_ONNX = ("input", "color", "mean", "std", "scale", "standardize")


def check(args: argparse.Namespace, fail: Callable[[str], None]) -> None:
    """Call `fail` with the first option that doesn't go with the others."""

    def given(name: str) -> bool:
        return getattr(args, name) not in (None, False)

    words = args.end_to_end or ()
    for one, other in (("uint8", "float32"), ("bgr", "rgb")):
        if one in words and other in words:
            fail(f"--end-to-end: pixels are {one} or {other}, not both")
    if "opencv" in words and not args.rounds:
        fail("--end-to-end opencv needs --rounds, such as --rounds 3: cv2.dnn runs no Loop")
    for alone in filter(given, ALONE):
        others, why = ALONE[alone]
        plain = vars(parser().parse_args([]))
        for name in (name for name, value in vars(args).items() if value != plain[name]):
            if name not in (alone, *others):
                fail(f"{why}; --{name.replace('_', '-')} does not go with it")
        if alone == "elf" and args.end_to_end is None:
            fail("--elf needs --end-to-end, which is what is added to the model")
        return
    if args.net is not None and args.onnx is not None:
        fail("--net and --onnx exclude each other: a network of ours, or a model of yours")
    for name in ONLY_WITH_NET if ":" in (args.desc or "") else (*ONLY_WITH_NET, *OF_NAMED_NETWORKS):
        if given(name) and args.net is None:
            also = " (or with --desc NET:LAYER)" if name in OF_NAMED_NETWORKS else ""
            fail(
                f"--{name.replace('_', '-')} goes with --net only{also}: it is about a network that comes with the "
                "exporter"
            )
    for name in ONLY_WITH_ONNX:
        if given(name) and args.onnx is None:
            working = f"; the working scale is --set scale={args.scale:g}" if name == "scale" else ""
            fail(f"--{name} goes with --onnx only: it describes the image input of such a model, and a network of "
                 f"--net brings its own description{working}")  # fmt: skip
    for name in ("mean", "std", "scale"):
        if args.standardize and given(name):
            fail(f"--standardize and --{name} exclude each other")
        if args.color == "gray" and name != "scale" and given(name) and len(getattr(args, name)) != 1:
            fail(f"--{name} has {len(getattr(args, name))} numbers, --color gray has one channel")
    if args.std is not None and min(map(abs, args.std)) == 0:
        fail("--std has a zero, by which the pixels would be divided")
    for name in ("desc_reduce", "whiten", "keep_weights"):
        if given(name) and args.desc_dim is None:
            fail(f"--{name.replace('_', '-')} goes with --desc-dim only")
    fitted = args.desc_dim is not None or args.compress is not None or args.precision != "fp32"
    if args.rounds and args.end_to_end is None:
        fail("--rounds goes with --end-to-end only")
    if args.calibration is not None and not fitted:
        fail("--calibration goes with --compress, --desc-dim or --precision only")
    if args.desc_dim is not None and args.desc == "none":
        fail("--desc none leaves no descriptor for --desc-dim to project")
    if args.desc_dim is not None and args.desc_dim < 1:
        fail(f"--desc-dim is 1 or more, not {args.desc_dim}")
    if args.whiten is not None and not 0.0 <= args.whiten <= 1.0:
        fail(f"--whiten is a number from 0 to 1, not {args.whiten:g}")
    if args.whiten and args.desc_reduce == "channels":
        fail("--whiten divides principal components; it goes with --desc-reduce pca only")
    if layers_of(args.desc) == [] and args.desc != "none":
        fail(f"--desc {args.desc!r} names no layer; --desc none is for a detector without descriptors")
    if args.list:
        return
    if args.net is None and args.onnx is None:
        fail("--net or --onnx is required (--list shows the networks), or --elf")
    if args.onnx is not None:
        if args.layer is None:
            fail("--onnx needs --layer (--list shows the layers)")
        if args.desc is None:
            fail("--onnx needs --desc: layers to describe keypoints with, or none")
