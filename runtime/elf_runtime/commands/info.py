"""elf-info: what a model is, what it costs, and where it runs."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import onnxruntime as ort

from elf_runtime.contract import SCHEMA_VERSION, ModelContract
from elf_runtime.coverage import Coverage, measure
from elf_runtime.errors import ElfError
from elf_runtime.onnx_file import OnnxFile, Tensor, read_onnx
from elf_runtime.session import bundled_model, open_session, resolve_providers

from . import _common
from ._info_text import report_text

DESCRIPTION = """\
Show what an ELF model is: its network and layer, descriptors, default detection settings, the origin of its
weights, the ops and tensors of its graph, its arithmetic, and which of the installed execution providers run
every op of it.

The providers are measured: the model runs once on a small image, and ONNX Runtime's profile says which one
executed each node. The ops counted there are those after ONNX Runtime's fusions and layout changes."""

EPILOG = """\
exit status: 0; 1 if the file is no ELF model (of another .onnx file, what can be read is still shown) or the
provider that --provider names can't run it; 2 on a wrong command line"""


def build_parser() -> argparse.ArgumentParser:
    parser = _common.new_parser("elf-info", DESCRIPTION, EPILOG)
    parser.add_argument("model", nargs="?", metavar="MODEL", help="an .onnx file; default: the bundled model")
    parser.add_argument(
        "--provider", metavar="NAME", help="measure this provider only; default: all installed"
    )
    parser.add_argument("--json", action="store_true", help="print everything as JSON")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    return _common.run(build_parser(), _work, argv)


def _work(args: argparse.Namespace) -> int:
    path = Path(args.model) if args.model else bundled_model()
    file = read_onnx(path)
    report: dict[str, Any] = {"file": str(path), "bytes": path.stat().st_size, "graph": _graph(file)}
    failure: ElfError | None = None
    coverages: list[Coverage] = []
    try:
        contract = _checked_contract(path, file)
        report |= {"schema": SCHEMA_VERSION, "contract": dataclasses.asdict(contract)}
        report["gflop_per_megapixel"] = gflop_per_megapixel(contract)
        wanted = [str(p) for p in resolve_providers(args.provider, fallback=False)] if args.provider else None
        coverages = [measure(path, contract, name) for name in wanted or ort.get_available_providers()]
        report["providers"] = {
            c.provider: {**dataclasses.asdict(c), "complete": c.complete} for c in coverages
        }
    except ElfError as error:
        failure = error
    print(json.dumps(report, indent=2) if args.json else report_text(report, coverages))
    sys.stdout.flush()
    failures: list[object] = [failure] if failure else []
    if args.provider:  # of all that are installed, one that does not start here is no failure of the model's
        failures += [f"{c.provider} can't run {path}: {c.error}" for c in coverages if c.error]
    for reason in failures:
        _common.report("elf-info", reason)
    return _common.FAILED if failures else 0


def _checked_contract(path: Path, file: OnnxFile) -> ModelContract:
    """The contract, held against the tensors that the session has."""
    contract = ModelContract.from_metadata(file.metadata, str(path))
    session, name = open_session(path)
    contract.check_tensors(session.get_inputs(), session.get_outputs(), name)
    return contract


def gflop_per_megapixel(contract: ModelContract) -> dict[str, float]:
    """Arithmetic of the saliency alone, and with all descriptor maps; a multiply-add is two operations."""
    keys = {"saliency": "saliency_macs_per_pixel", "all outputs": "descriptors_macs_per_pixel"}
    # MACs a pixel * 2 * 1e6 pixels / 1e9
    return {name: contract.cost[key] * 2e-3 for name, key in keys.items() if key in contract.cost}


def _graph(file: OnnxFile) -> dict[str, Any]:
    def named(tensors: Sequence[Tensor]) -> dict[str, Any]:
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
        "inputs": named(file.inputs),
        "outputs": named(file.outputs),
        "ops": file.op_counts(),
        "stored": by_dtype,
    }


if __name__ == "__main__":
    sys.exit(main())
