"""elf-info: what a model is, what it costs, and where it runs."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import onnxruntime as ort

from elf_runtime.contract import SCHEMA_VERSION, ModelContract
from elf_runtime.coverage import Coverage, measure
from elf_runtime.errors import ElfError
from elf_runtime.onnx_file import OnnxFile, Tensor, read_onnx
from elf_runtime.session import bundled_model, open_session, resolve_providers

from . import _common

DESCRIPTION = """\
Show what an ELF model is: its network and layer, descriptors, default detection settings, the origin of its
weights, the ops and tensors of its graph, its arithmetic, and which of the installed execution providers run
every op of it.

The providers are measured: the model runs once on a small image, and ONNX Runtime's profile says which provider
executed each node. The ops counted there are those after ONNX Runtime's fusions and layout changes."""

EPILOG = """\
exit status: 0; 1 if the file is no ELF model (of another .onnx file, what can be read is still shown) or a
provider can't run it; 2 on a wrong command line"""


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
    print(json.dumps(report, indent=2) if args.json else _text(report, coverages))
    if failure is not None:
        sys.stdout.flush()
        _common.report("elf-info", failure)
    return _common.FAILED if failure is not None or any(c.error for c in coverages) else 0


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


def _text(report: Mapping[str, Any], coverages: Sequence[Coverage]) -> str:
    rows = [f"{report['file']}  ({_size(report['bytes'])})"]
    if "contract" in report:
        rows += _contract_rows(report["contract"], report["gflop_per_megapixel"])
    graph = report["graph"]
    opsets = ", ".join(f"{domain} {version}" for domain, version in graph["opsets"].items())
    form = f"IR {graph['ir_version']}, opset {opsets}; {graph['producer']}".rstrip("; ")
    rows += ["", "graph", _row("format", form)]
    for kind in ("inputs", "outputs"):
        rows += [
            _row(kind[:-1], f"{name}  {tensor['dtype']} ({', '.join(map(str, tensor['dims']))})")
            for name, tensor in graph[kind].items()
        ]
    for dtype, entry in graph["stored"].items():
        size = f"{entry['values']:,} values in {entry['tensors']} tensors, {_size(entry['bytes'])}"
        rows.append(_row(f"stored {dtype}", size))
    rows.append(_row("ops", f"{sum(graph['ops'].values())} nodes: {_counts(graph['ops'])}"))
    if coverages:
        rows += ["", f"execution providers (onnxruntime {ort.__version__})"]
        rows += [_row(c.provider.removesuffix("ExecutionProvider"), _coverage(c)) for c in coverages]
    return "\n".join(rows)


def _contract_rows(contract: Mapping[str, Any], gflop: Mapping[str, float]) -> list[str]:
    spec, weights = contract["input"], contract["weights"]
    rows = ["", "model"]
    rows.append(
        _row("network, layer", f"{contract['network']} {contract['layer']}, stride {contract['stride']:g}")
    )
    for d in contract["descriptors"] or [None]:
        text = f"{d['layer']}: {d['dim']} values, a cell every {d['stride']:g} pixels" if d else "none"
        rows.append(_row("descriptor", text))
    pixels = (
        f"{spec['color']} pixels 0..{spec['value_range']:g}, at least {spec['min_size']}x{spec['min_size']}"
    )
    rows.append(_row("input", f"{spec['dtype']} {spec['layout']}, {pixels}"))
    rows.append(_row("preprocessing", contract["preprocessing"] or "not recorded"))
    rows.append(_row("precision", contract["precision"]))
    origin = [weights["source"], f"licence {weights['licence']}" if weights["licence"] else ""]
    rows.append(_row("weights", ", ".join(filter(None, origin)) or "not recorded"))
    if weights["sha256"]:
        rows.append(_row("sha256", weights["sha256"]))
    rows.append(_row("detection", ", ".join(f"{k} {_short(v)}" for k, v in contract["detection"].items())))
    if "params" in contract["cost"]:
        rows.append(_row("parameters", f"{int(contract['cost']['params']):,}"))
    costs = [f"{value:.1f} GFLOP per megapixel ({name})" for name, value in gflop.items()]
    rows.append(_row("arithmetic", ", ".join(costs) or "not recorded"))
    for key in ("parity", "versions"):
        if contract[key]:
            rows.append(_row(key, ", ".join(f"{k} {_short(v)}" for k, v in contract[key].items())))
    if contract["command"]:
        rows.append(_row("made by", contract["command"]))
    return rows


def _coverage(coverage: Coverage) -> str:
    if coverage.error:
        return f"can't run it: {coverage.error}"
    if coverage.complete:
        return f"runs every op ({sum(coverage.ran.values())} executed nodes)"
    others = "; ".join(f"{name} runs {_counts(ops)}" for name, ops in coverage.elsewhere.items())
    if not coverage.ran:
        return f"runs no op; all is left to {', '.join(coverage.elsewhere) or 'nobody'}"
    return f"runs {_counts(coverage.ran)}; {others}"


def _counts(ops: Mapping[str, int]) -> str:
    return ", ".join(f"{op} {count}" for op, count in ops.items())


def _short(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return "(" + ", ".join(_short(v) for v in value) + ")"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _size(count: int) -> str:
    return f"{count / 1e6:.2f} MB" if count >= 100_000 else f"{count / 1e3:.1f} kB"


def _row(label: str, text: str) -> str:
    head = f"  {label:<16} "
    return textwrap.fill(
        text,
        110,
        initial_indent=head,
        subsequent_indent=" " * len(head),
        break_long_words=False,
        break_on_hyphens=False,
    )


if __name__ == "__main__":
    sys.exit(main())
