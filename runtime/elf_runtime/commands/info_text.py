"""elf-info's report as text."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

import onnxruntime as ort

from elf_runtime.errors import one_line, printable, shortened

# What the contract's keys of `parity` mean; the errors are the worst of the export's checks.
_PARITY = {
    "median_error": "median error of the saliency against float64, of its maximum",
    "max_error": "largest error of the saliency, of its maximum",
    "share_above_1e-4": "share of its pixels with an error above 1e-4 of the maximum",
    "keypoint_agreement": "share of float64's keypoints at the same pixel",
    "derivative_median_error": "median error of derivatives against central differences, relative",
    "derivative_max_error": "largest error of derivatives against central differences, relative",
    "saliency_median_error": "median error of the saliency against the mean of |gradient|, of its maximum",
    "float32_median_error": "median error of float32's gradient against float64's, of its maximum",
    "float32_error_of_99_percent": "99 % of float32's gradient against float64's within, of its maximum",
    "descriptor_error": "largest error of the projected descriptors, of their largest value",
    "compressed_correlation": "correlation of the saliency with the whole network's",
    "compressed_agreeing": "share of the whole network's keypoints that have one within a pixel",
    "compressed_keypoints": "keypoints of an image, compressed",
    "compressed_keypoints_whole": "keypoints of an image, by the whole network",
    "compressed_rep": "repeatability between images and views of them, compressed, %",
    "compressed_rep_whole": "repeatability between images and views of them, by the whole network, %",
    "compressed_ms": "matching score between images and views of them, compressed, %",
    "compressed_ms_whole": "matching score between images and views of them, by the whole network, %",
    "compressed_mma@1": "matches within a pixel of the truth, compressed, %",
    "compressed_mma@1_whole": "matches within a pixel of the truth, by the whole network, %",
    "lower_correlation": "correlation of the saliency in {precision} with fp32's",
    "lower_agreeing": "share of fp32's keypoints that have one in {precision} within a pixel",
    "lower_keypoints": "keypoints of an image in {precision}",
    "lower_keypoints_fp32": "keypoints of an image in fp32",
    "lower_rep": "repeatability between images and views of them in {precision}, %",
    "lower_rep_fp32": "repeatability between images and views of them in fp32, %",
    "lower_ms": "matching score between images and views of them in {precision}, %",
    "lower_ms_fp32": "matching score between images and views of them in fp32, %",
    "alone_near": "share of the runtime's keypoints that the file alone has within 0.01 px",
    "alone_counts": "share of the images where it has as many as the runtime",
    "alone_cosine": "least cosine of its descriptors with the runtime's",
}


# What a screen is for: a file may hold a thousand tensors, or a megabyte of text.
_MOST_ROWS = 20
_LONGEST = 1000  # characters of an entry


def report_text(report: Mapping[str, Any]) -> str:
    """The report of one model, for reading."""
    rows = [f"{one_line(report['file'])}  ({_size(report['bytes'])})"]
    if "contract" in report:
        rows += _contract_rows(report["contract"], report["gflop_per_megapixel"])
    rows += _graph_rows(report["graph"]) if report["graph"] else ["", "in ORT format: its graph is not listed"]
    if "providers" in report:
        rows += ["", f"execution providers (onnxruntime {ort.__version__})"]
        for name, run in report["providers"].items():
            rows.append(_row(name.removesuffix("ExecutionProvider"), _coverage(run)))
            if run["agreement"]:
                rows.append(_row("", _agreement(run["agreement"])))
        if report["elsewhere"]:
            rows += ["", "not installed here, tried with the bundled models"]
            rows += [_row(name.removesuffix("ExecutionProvider"), text) for name, text in report["elsewhere"].items()]
    if "ort" in report:
        rows += ["", f"wrote {one_line(report['ort'])}"]
    return "\n".join(rows)


def _graph_rows(graph: Mapping[str, Any]) -> list[str]:
    opsets = ", ".join(f"{domain} {version}" for domain, version in graph["opsets"].items())
    form = f"IR {graph['ir_version']}, opset {opsets}; {graph['producer']}".rstrip("; ")
    rows = ["", "graph", _row("format", form)]
    for kind in ("inputs", "outputs"):
        rows += [
            _row(kind[:-1], f"{name}  {tensor['dtype']} ({', '.join(map(str, tensor['dims']))})")
            for name, tensor in list(graph[kind].items())[:_MOST_ROWS]
        ]
        if len(graph[kind]) > _MOST_ROWS:
            rows.append(_row("", f"and {len(graph[kind]) - _MOST_ROWS} more {kind}"))
    for dtype, entry in graph["stored"].items():
        size = f"{entry['values']:,} values in {entry['tensors']} tensors, {_size(entry['bytes'])}"
        rows.append(_row(f"stored {dtype}", size))
    rows.append(_row("ops", f"{sum(graph['ops'].values())} nodes: {_counts(graph['ops'])}"))
    return rows


def _contract_rows(contract: Mapping[str, Any], gflop: Mapping[str, float]) -> list[str]:
    spec, weights = contract["input"], contract["weights"]
    rows = ["", "model"]
    rows.append(_row("network, layer", f"{contract['network']} {contract['layer']}, stride {contract['stride']:g}"))
    described = contract["descriptors"] or [None]
    rows += [_row("descriptor", _descriptor(d) if d else "none") for d in described[:_MOST_ROWS]]
    if len(described) > _MOST_ROWS:
        rows.append(_row("", f"and {len(described) - _MOST_ROWS} more descriptors"))
    pixels = f"{spec['color']} pixels 0..{spec['value_range']:g}, {_sizes(spec)}"
    given = contract.get("end_to_end")
    rows.append(_row("network's input" if given else "input", f"{spec['dtype']} {spec['layout']}, {pixels}"))
    if given:
        rows.append(_row("end to end", _end_to_end(contract["end_to_end"])))
    rows.append(_row("preprocessing", contract["preprocessing"] or "not recorded"))
    rows.append(_row("precision", contract["precision"]))
    if contract.get("pooling"):
        rows.append(_row("pooling", f"{contract['pooling']}, for the detector, in place of the network's maxima"))
    if contract.get("compression"):
        rows.append(_row("compression", _compression(contract["compression"])))
    origin = [weights["source"], f"licence {weights['licence']}" if weights["licence"] else ""]
    rows.append(_row("weights", ", ".join(filter(None, origin)) or "not recorded"))
    if contract["receptive_field"]:
        rows.append(_row("receptive field", f"{contract['receptive_field']:g} pixels of the working image"))
    if weights["sha256"]:
        rows.append(_row("sha256", weights["sha256"]))
    rows.append(_row("detection", ", ".join(f"{k} {_short(v)}" for k, v in contract["detection"].items())))
    if "params" in contract["cost"]:
        rows.append(_row("parameters", f"{int(contract['cost']['params']):,}"))
    costs = [f"{value:.1f} GFLOP per megapixel ({name})" for name, value in gflop.items()]
    rows.append(_row("arithmetic", ", ".join(costs) or "not recorded"))
    rows += _parity_rows(contract["parity"], contract["precision"])
    if contract["versions"]:
        rows.append(_row("versions", ", ".join(f"{k} {v}" for k, v in contract["versions"].items())))
    if contract["command"]:
        rows.append(_row("made by", contract["command"]))
    return rows


def _end_to_end(form: Mapping[str, Any]) -> str:
    images = f"{'images' if form['batch'] else 'an image'} of {form['pixels']} {form['color']}"
    rounds = f"{form['rounds']} rounds unrolled" if form["rounds"] else "a Loop"
    return f"the file gives keypoints itself, for {images}; suppression by {rounds}"


def _parity_rows(parity: Mapping[str, float], precision: str) -> list[str]:
    """A line for each figure, in words; one that this version does not know under its own name."""
    known = {key: text.format(precision=precision) for key, text in _PARITY.items() if key in parity}
    texts = [f"{text}: {_short(parity[key])}" for key, text in known.items()]
    others = [f"{key}: {_short(value)}" for key, value in parity.items() if key not in _PARITY]
    texts += others[:_MOST_ROWS]
    if len(others) > _MOST_ROWS:
        texts.append(f"and {len(others) - _MOST_ROWS} more")
    return [_row("" if index else "parity", text) for index, text in enumerate(texts)]


def _descriptor(spec: Mapping[str, Any]) -> str:
    text = f"{spec['layer']}: {spec['dim']} values, a cell every {spec['stride']:g} pixels"
    if spec.get("scale", 1.0) != 1.0:
        text += f", of the image at {spec['scale']:g} of its size"
    reduction = spec["reduction"]
    if reduction is None:
        return text
    whiten = f", whitened by {reduction['whiten']:g}" if reduction["whiten"] else ""
    return (
        f"{text}; of {reduction['source_dim']} channels by {reduction['method']}{whiten}, {reduction['kept']:.0%} of "
        f"their variance, fitted to {reduction['calibration']} (SHA-256 {reduction['sha256'][:16]}...)"
    )


def _compression(spec: Mapping[str, Any]) -> str:
    ranks = ", ".join(f"{name} {rank}" for name, rank in list(spec["ranks"].items())[:_MOST_ROWS])
    more = ", ..." if len(spec["ranks"]) > _MOST_ROWS else ""
    return (
        f"convolutions in low rank: {ranks}{more}; {spec['multiply_adds']:.0%} of their multiply-adds, fitted to "
        f"{spec['calibration']} (SHA-256 {spec['sha256'][:16]}...)"
    )


def _coverage(run: Mapping[str, Any]) -> str:
    if run["error"]:
        return f"can't run it: {run['error']}"
    if run["complete"]:
        return f"runs every op ({sum(run['ran'].values())} executed nodes)"
    others = "; ".join(f"{name} runs {_counts(ops)}" for name, ops in run["elsewhere"].items())
    if not run["ran"]:
        return f"runs no op; all is left to {', '.join(run['elsewhere']) or 'nobody'}"
    return f"runs {_counts(run['ran'])}; {others}"


def _agreement(found: Mapping[str, Any]) -> str:
    text = (
        f"{found['found']} keypoints, the CPU {found['reference']}; "
        f"{found['same']:.1%} the same within 0.5 px, {found['near']:.1%} within 1 px"
    )
    if found["cosine"] is not None:
        text += f"; cosine of their descriptors {found['cosine']:.5f}, at least {found['least_cosine']:.5f}"
    return text if found["sufficient"] else f"DIFFERS: {text}"


def _counts(ops: Mapping[str, int]) -> str:
    return ", ".join(f"{op} {count}" for op, count in ops.items())


def _short(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return "(" + ", ".join(_short(v) for v in value) + ")" if value else "none"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _size(count: int) -> str:
    return f"{count / 1e6:.2f} MB" if count >= 100_000 else f"{count / 1e3:.1f} kB"


def _sizes(spec: Mapping[str, Any]) -> str:
    """Which image sizes the graph takes."""
    if spec["height"] or spec["width"]:
        return f"resized to {spec['width'] or 'any'}x{spec['height'] or 'any'} (width x height)"
    text = f"at least {spec['min_size']}x{spec['min_size']}"
    return text if spec["multiple"] == 1 else f"{text}, resized to multiples of {spec['multiple']}"


def _row(label: str, text: str) -> str:
    head = f"  {label:<16} "
    return textwrap.fill(
        printable(shortened(text, _LONGEST)),
        110,
        initial_indent=head,
        subsequent_indent=" " * len(head),
        break_long_words=False,
        break_on_hyphens=False,
    )
