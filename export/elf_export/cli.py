"""`elf-export`: a CNN in, an ELF model (one .onnx file) out."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from .errors import ExportError

EPILOG = """\
examples:
  elf-export --net vgg --layer pool2                     the paper's detector, described by pool4
  elf-export --net vgg --layer pool1 --desc pool3        a cheaper one
  elf-export --net vgg --layer pool2 --desc none         saliency and keypoints only
  elf-export --net superpoint --desc vgg:pool3 --weights superpoint_v1.pth
                                                         SuperPoint detects, VGG describes
  elf-export --net vgg --list                            the layers to choose from
"""


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="elf-export",
        description="Write one .onnx file that computes a CNN's saliency |F^T dF/dI| (the backward pass is in the "
        "graph) and its descriptor maps; elf_runtime finds keypoints with it, without PyTorch.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    p.add_argument("--net", metavar="NAME", help="a network that comes with the exporter; --list shows them")
    p.add_argument("--layer", metavar="LAYER", help="the layer F that keypoints come from (default: the paper's)")
    p.add_argument(
        "--desc", metavar="LAYER[,LAYER...]|none",
        help="layers that describe the keypoints, the first being the default; NET:LAYER takes another network's "
        "(default: the paper's)",
    )  # fmt: skip
    p.add_argument(
        "--weights", metavar="FILE",
        help="trained weights: .pth, .h5, .keras, .safetensors, .npz or .onnx (default: the published ones, from "
        "the cache, the bundled model, the publisher or a package index)",
    )  # fmt: skip
    p.add_argument(
        "--preprocess", choices=("paper", "own"), default="paper",
        help="what the detector is fed: each image standardised (the paper's), or what it was trained with",
    )  # fmt: skip
    p.add_argument("--desc-weights", metavar="FILE", help="weights of the other network of --desc NET:LAYER")
    p.add_argument("--output", "-o", metavar="FILE", help="default: elf-NET-LAYER.onnx")
    p.add_argument("--opset", type=int, default=17, help="ONNX opset of the file, 11 to 20 (default: 17)")
    p.add_argument("--force", action="store_true", help="overwrite an existing file")
    p.add_argument("--offline", action="store_true", help="never use the network; so does ELF_OFFLINE=1")
    p.add_argument("--list", action="store_true", help="list the networks, or the layers of --net, and stop")
    return p


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status (0 done, 1 failed, 2 wrong usage)."""
    p = parser()
    args = p.parse_args(argv)
    try:
        import onnx  # noqa: F401
    except ImportError:
        print("elf-export: error: exporting needs more: pip install 'elf-onnx[export]'", file=sys.stderr)
        return 1
    try:
        if args.list:
            return _list(args)
        if args.net is None:
            p.error("--net is required (--list shows the networks)")
        return _export(args)
    except ExportError as error:
        print(f"elf-export: error: {error}", file=sys.stderr)
        return 1


def _export(args: argparse.Namespace) -> int:
    from .export import export_network

    descriptors = None
    if args.desc is not None:
        descriptors = [] if args.desc == "none" else [name.strip() for name in args.desc.split(",") if name.strip()]
    result = export_network(
        args.net, args.layer, descriptors, args.output, weights=args.weights, opset=args.opset,
        force=args.force, offline=args.offline, desc_weights=args.desc_weights,
        preprocessing=args.preprocess, log=print,
    )  # fmt: skip
    size = result.path.stat().st_size / 1e6
    print(f"wrote {result.path} ({size:.1f} MB): {result.contract.network} {result.contract.layer}, descriptors "
          f"{', '.join(d.layer for d in result.contract.descriptors) or 'none'}")  # fmt: skip
    return 0


def _list(args: argparse.Namespace) -> int:
    from .listing import network_table
    from .networks import get_network, network_names

    if args.net is None:
        for name in network_names():
            network = get_network(name)
            described = ",".join(network.default_descriptors) or "none"
            print(f"{name:<20}{network.title}; default --layer {network.default_layer} --desc {described}")
    else:
        print(network_table(get_network(args.net)))
    return 0
