"""elf-info: what a model is, what it costs, and where it runs."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy.typing as npt
import onnxruntime as ort

from elf_runtime.checks.agreement import compare, pattern
from elf_runtime.contract import SCHEMA_VERSION, ModelContract
from elf_runtime.detection.working_image import prepare
from elf_runtime.engine import ElfRuntime
from elf_runtime.errors import ElfError
from elf_runtime.image.file import image_errors, read
from elf_runtime.model import bundled_model
from elf_runtime.model.coverage import measure
from elf_runtime.model.onnx_file import OnnxFile, Tensor, read_onnx
from elf_runtime.model.ort_format import is_ort_format, to_ort
from elf_runtime.model.providers import Provider, computes_int8, resolve_providers

from . import command, options
from .command import UsageError
from .info_text import report_text
from .info_tried import elsewhere
from .outputs import check_outputs
from .parser import Parser, add_json, new_parser
from .terminal import say

DESCRIPTION = """\
Show what an ELF model is: its network and layer, descriptors, default detection settings, the origin of its
weights, the ops and tensors of its graph, its arithmetic, and which of the installed execution providers run
every op of it.

The providers are measured: the model runs once on a small image, and ONNX Runtime's profile says which one
executed each node. The ops counted there are those after ONNX Runtime's fusions and layout changes. Keypoints and
descriptors of each provider but the CPU are held against the CPU's on a test picture, or on --image: shares are of
the larger number of keypoints. Of the other providers and runtimes it says what was tried with the bundled models,
and when."""

EPILOG = """\
exit status: 0; 1 if the file is no ELF model (of another .onnx file, what can be read is still shown), if --image
can't be used, or if the provider that --provider names can't run it or has less than 90 % of the CPU's keypoints
within a pixel; 2 on a wrong command line

examples:
  elf-info model.onnx --provider tensorrt
  elf-info model.onnx --provider openvino --image photo.jpg \\
      --provider-option 'load_config={"CPU": {"INFERENCE_PRECISION_HINT": "bf16"}}'"""


def build_parser() -> Parser:
    parser = new_parser("elf-info", DESCRIPTION, EPILOG)
    parser.add_argument("model", nargs="?", metavar="MODEL", help="an .onnx or .ort file; default: the bundled model")
    options.add_provider(parser, "measure this provider only; default: all installed")
    parser.add_argument("--image", metavar="FILE", help="compare the keypoints on this image")
    parser.add_argument("--ort", metavar="FILE", help="write the model in ORT format (.ort) too")
    parser.add_argument(
        "--this-machine", action="store_true",
        help="optimise that file for this processor's vectors: faster, and for such processors only",
    )  # fmt: skip
    add_json(parser, "everything")
    options.add_quiet(parser)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    return command.run(build_parser(), _work, argv)


def _work(args: argparse.Namespace) -> int:
    asked = options.provider(args)
    if args.this_machine and not args.ort:
        raise UsageError("--this-machine is for the file that --ort names")
    check_outputs({"--ort": [args.ort], "--json": [args.json]}, {"the image": [args.image], "the model": [args.model]})
    image = pattern() if args.image is None else read(args.image)
    path = Path(args.model) if args.model else bundled_model("int8" if computes_int8(asked) else "fp32")
    graph = None if is_ort_format(path) else _graph(read_onnx(path))
    report: dict[str, Any] = {"file": str(path), "bytes": path.stat().st_size, "graph": graph}
    failures: list[object] = []
    try:
        contract = ElfRuntime(path).contract
        report |= {"schema": SCHEMA_VERSION, "contract": dataclasses.asdict(contract)}
        report["gflop_per_megapixel"] = gflop_per_megapixel(contract)
        if args.image is not None:
            with image_errors(args.image):
                prepare(image, contract.detection, None, contract, str(path))
        wanted = resolve_providers(asked, fallback=False) if asked else ort.get_available_providers()
        runs = [_measured(path, contract, provider, image) for provider in wanted]
        report["providers"] = {run["provider"]: run for run in runs}
        report["elsewhere"] = {} if asked else elsewhere(report["providers"])
        if asked:  # of all that are installed, one that does not start here is no failure of the model's
            failures += filter(None, (_failure(run, path) for run in runs))
    except ElfError as error:
        failures = [error]
    if args.ort and not failures:
        to_ort(path, args.ort, this_machine=args.this_machine)
        report["ort"] = args.ort
    if failures:
        report["error"] = "\n".join(map(str, failures))
    if args.json:
        command.write_json(args.json, report)
    if args.json != "-" and not args.quiet:
        say(report_text(report))
    sys.stdout.flush()
    for reason in failures:
        command.report("elf-info", reason)
    return command.FAILED if failures else 0


def _measured(path: Path, contract: ModelContract, provider: Provider, image: npt.NDArray[Any]) -> dict[str, Any]:
    """What the provider ran of the model, and its keypoints against the CPU's."""
    coverage = measure(path, contract, provider)
    run: dict[str, Any] = {**dataclasses.asdict(coverage), "complete": coverage.complete, "agreement": None}
    if not coverage.error and coverage.provider != "CPUExecutionProvider":
        try:
            found = compare(ElfRuntime(path), ElfRuntime(path, providers=provider), image)
            run["agreement"] = {**dataclasses.asdict(found), "sufficient": found.sufficient}
        except ElfError as error:
            run["error"] = str(error)
    return run


def _failure(run: Mapping[str, Any], path: Path) -> str:
    if run["error"]:
        return f"{run['provider']} can't run {path}: {run['error']}"
    if run["agreement"] and not run["agreement"]["sufficient"]:
        share = run["agreement"]["near"]
        return f"{run['provider']} finds other keypoints in {path} than the CPU: {share:.0%} agree within 1 px"
    return ""


def gflop_per_megapixel(contract: ModelContract) -> dict[str, float]:
    """Arithmetic of the saliency alone, and with all descriptor maps; a multiply-add is two operations."""
    keys = {"saliency": "saliency_macs_per_pixel", "all outputs": "descriptors_macs_per_pixel"}
    # MACs a pixel * 2 * 1e6 pixels / 1e9
    return {name: contract.cost[key] * 2e-3 for name, key in keys.items() if key in contract.cost}


def _graph(file: OnnxFile) -> dict[str, Any]:
    def by_name(tensors: Sequence[Tensor]) -> dict[str, Any]:
        return {t.name: {"dtype": t.dtype, "dims": list(t.dims)} for t in tensors}

    by_dtype: dict[str, dict[str, int]] = {}
    for tensor in file.initializers:
        entry = by_dtype.setdefault(tensor.dtype, {"tensors": 0, "values": 0, "bytes": 0})
        entry["tensors"] += 1
        entry["values"] += tensor.size
        entry["bytes"] += tensor.nbytes
    return {
        "ir_version": file.ir_version,
        "opsets": file.opsets,
        "producer": file.producer,
        "inputs": by_name(file.inputs),
        "outputs": by_name(file.outputs),
        "ops": file.op_counts(),
        "stored": by_dtype,
    }


if __name__ == "__main__":
    sys.exit(main())
