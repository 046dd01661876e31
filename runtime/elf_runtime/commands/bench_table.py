"""elf-bench's report as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def table(report: Mapping[str, Any]) -> str:
    """The report of one run, for reading."""
    env, model, start = report["environment"], report["model"], report["start_up"]
    used = [note for note in report["peers"].values() if note.startswith("torch ")]
    left_out = {name: note for name, note in report["peers"].items() if note not in used}
    usable = env["usable_cores"] or env["cores"]
    rows = [
        f"{model['network']} {model['layer']} ({model['file']})",
        f"{env['provider']}, {env['threads']} threads{', spinning' if report['spin'] else ''}",
        f"{env['cpu']}, {usable} of {env['cores']} cores, load {env['load_average']}",
        env["platform"],
        ", ".join(f"{name} {env[name]}" for name in ("python", "onnxruntime", "numpy", "opencv"))
        + "".join(f", {note}" for note in used),
        f"image: {report['image']}; preset {', '.join([report['preset'], *report['set']])}",
        f"{report['repeats']} interleaved repetitions after {report['warmup']} of warm-up",
        f"start-up, median of {start['processes']} fresh processes: import {1e3 * start['import_s']:.0f} ms, "
        f"load {1e3 * start['load_s']:.0f} ms",
    ]
    rows += [f"left out: {name}: {note}" for name, note in left_out.items()]
    for entry in report["sizes"]:
        rows += ["", *_size_rows(entry)]
    if len(report["sizes"]) > 1:
        rows += ["", *_growth_rows(report["sizes"])]
    return "\n".join(rows)


def _size_rows(entry: Mapping[str, Any]) -> list[str]:
    size = f"{entry['height']}x{entry['width']}"
    rows = [f"{size:<36}{'p50':>10}{'p95':>10}{'p99':>10} ms   keypoints"]
    for name, seconds in entry["seconds"].items():
        owner, _, stage = name.partition(".")
        label = f"    {stage}" if stage else f"  {entry['titles'][owner]}"
        times = "".join(f"{1e3 * seconds[p]:10.2f}" for p in ("p50", "p95", "p99"))
        count = "" if stage or owner not in entry["keypoints"] else f"{entry['keypoints'][owner]:15d}"
        rows.append(f"{label:<36}{times}{count}")
    for pair, ratio in entry["ratios"].items():
        name = " / ".join(_title(side, entry["titles"]) for side in pair.split(" / "))
        rows.append(f"  {name}: {ratio['value']:.3g} [{ratio['low']:.3g}, {ratio['high']:.3g}]")
    if "saliency_agreement" in entry:
        agreement = entry["saliency_agreement"]
        share, precision = 100 * agreement["share"], agreement["precision"]
        rows.append(
            f"  ELF's saliency in {precision} and torch's agree to 1e-4 of the maximum at {share:.2f} % of the pixels"
        )
    memory = entry["memory"]
    if memory["peak_detect_bytes"] is not None:
        loaded, detected = (memory[key] / 2**20 for key in ("peak_loaded_bytes", "peak_detect_bytes"))
        rows.append(f"  peak memory of a fresh process: {loaded:.0f} MiB loaded, {detected:.0f} MiB detecting")
    rows.append(f"  first detection of a fresh process: {1e3 * memory['first_detect_s']:.0f} ms")
    return rows


def _title(name: str, titles: Mapping[str, str]) -> str:
    """``elf.detect + describe`` -> "ELF detect + describe"; ``sift`` -> its title."""
    owner, _, stage = name.partition(".")
    return f"{titles[owner].partition(',')[0]} {stage}" if stage else titles[owner]


def _growth_rows(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    """Median time per megapixel of the source image at each size: the same where time is linear in pixels."""
    stages = [stage for stage in ("session", "post-processing") if f"elf.{stage}" in entries[0]["seconds"]]
    rows = [f"{'per megapixel of the image':<26}" + "".join(f"{stage:>20}" for stage in stages) + " ms"]
    each = []
    for entry in entries:
        area = entry["height"] * entry["width"] / 1e6
        each.append([1e3 * entry["seconds"][f"elf.{stage}"]["p50"] / area for stage in stages])
        size = f"{entry['height']}x{entry['width']}"
        rows.append(f"  {size:<24}" + "".join(f"{value:20.1f}" for value in each[-1]))
    ratios = (last / first for first, last in zip(each[0], each[-1], strict=True))
    rows.append(f"  {'last / first':<24}" + "".join(f"{ratio:20.2f}" for ratio in ratios))
    return rows
