"""Search over models (layers) and settings: chosen on some scenes, reported on the others."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from decimal import Decimal
from itertools import product

import numpy as np

from elf_eval.data import open_dataset
from elf_eval.errors import EvalError
from elf_eval.metrics import Estimate, paired_difference
from elf_eval.metrics.names import check, is_share, names
from elf_eval.metrics.statistics import Difference
from elf_eval.protocol import Protocol
from elf_eval.report.summary import Keypoints, having, keypoints, scene_means, summarize
from elf_eval.run.results import Results
from elf_eval.run.runner import Resources, run
from elf_runtime.params import SETTINGS, setting_value

from .suite import DatasetEntry, MethodEntry, Suite

_DATASET = "sweep"
_MOST = 1000  # values of a range


@dataclass(frozen=True)
class Trial:
    """One setting: its metric on the scenes where it was chosen and on those where it was not.

    Attributes
    ----------
    text : str
        The method, as ``elf:vgg.onnx?denoise=5,2``.
    tuned : Estimate
    held_out : Estimate
    gain : Difference
        On the held-out scenes, against the first model with its own settings.
    count : Keypoints
        On the held-out scenes, of the pairs that have the metric.
    """

    text: str
    tuned: Estimate
    held_out: Estimate
    gain: Difference
    count: Keypoints


def parse_grid(items: list[str]) -> dict[str, list[str]]:
    """``["scale=1/0.5", "denoise=3..9..2,4..6"]`` -> the values of each setting.

    A value or each part of one between commas may be a range, ``FROM..TO`` or ``FROM..TO..STEP``, both ends
    included; of several ranges in a value every combination is taken.

    Raises
    ------
    EvalError
        On an unknown setting, a value that it can't take, or none.
    """
    grid: dict[str, list[str]] = {}
    for item in items:
        name, _, values = item.partition("=")
        if name not in SETTINGS:
            raise EvalError(f"grid {item!r}: unknown setting {name!r}; known are {sorted(SETTINGS)}")
        try:
            grid[name] = list(dict.fromkeys(v for text in values.split("/") for v in _in_range(text)))
            for text in grid[name]:
                setting_value(name, text)
        except (ValueError, ArithmeticError) as error:
            raise EvalError(f"grid {item!r}: {error}") from error
    return grid


def _in_range(text: str) -> list[str]:
    """The values that a text with ranges stands for; decimals are exact: 0.1..0.3..0.1 ends with 0.3."""
    parts = []
    for part in text.split(","):
        ends = part.split("..")
        if len(ends) == 1:
            parts.append([part])
            continue
        if len(ends) > 3 or not all(map(_is_decimal, ends)):
            raise ValueError(f"{part!r} is not FROM..TO or FROM..TO..STEP")
        first, last, step = (Decimal(end) for end in [*ends, "1"][:3])
        if step <= 0 or last < first:
            raise ValueError(f"{part!r}: a range goes upwards, by a step above 0")
        count = int((last - first) / step) + 1
        if count > _MOST:
            raise ValueError(f"{part!r} has {count} values; at most {_MOST}")
        parts.append([f"{first + k * step:f}" for k in range(count)])
    return [",".join(values) for values in product(*parts)]


def _is_decimal(text: str) -> bool:
    return re.fullmatch(r"-?[0-9]+(\.[0-9]+)?", text) is not None


def trials(models: list[str], grid: dict[str, list[str]], limit: int | None, seed: int) -> list[str]:
    """Every model with every combination; `limit` of them, drawn by `seed`, where there are more.

    The first is always the first model as it is.
    """
    texts = [models[0]]
    for model in models:
        for values in product(*grid.values()):
            options = "&".join(f"{name}={value}" for name, value in zip(grid, values, strict=True))
            texts.append(model + ("&" if "?" in model else "?") + options if options else model)
    unique = list(dict.fromkeys(texts))
    if limit is None or limit >= len(unique):
        return unique
    drawn = np.random.default_rng(seed).choice(len(unique) - 1, limit - 1, replace=False) + 1
    return [unique[0], *(unique[i] for i in sorted(drawn))]


def split(scenes: list[str], tune: list[str] | None) -> tuple[list[str], list[str]]:
    """The scenes to choose on, and the others; by default every second one, so that both parts are mixed.

    Raises
    ------
    EvalError
        If a part is empty or a scene unknown.
    """
    chosen = scenes[::2] if tune is None else tune
    if unknown := set(chosen) - set(scenes):
        raise EvalError(f"no scenes {sorted(unknown)}; there are {scenes}")
    rest = [scene for scene in scenes if scene not in chosen]
    if not chosen or not rest:
        raise EvalError(f"a sweep needs scenes on both sides: {chosen} to choose on, {rest} to report on")
    return chosen, rest


def sweep(
    texts: list[str],
    dataset: str,
    metric: str,
    top: int,
    protocol: Protocol,
    resources: Resources,
    tune: list[str] | None = None,
) -> list[Trial]:
    """Rank `texts` by `metric` on one part of the scenes; the `top` and the first on the other part.

    Returns
    -------
    list of Trial, the best first by the scenes where they were chosen; the reference is the last

    Raises
    ------
    EvalError
        If the dataset or the methods don't give the metric; before any work where it is the dataset.
    """
    opened = open_dataset(dataset)
    known = dict.fromkeys(name for pair in opened.pairs for name in names(pair.truth))
    check([metric], known, f"a run on {dataset} has")
    chosen, rest = split(opened.scenes(), tune)
    tuned = _run(texts, dataset, protocol, resources, chosen)
    scores = {text: summarize(tuned.of(_DATASET, text, "own"), metric) for text in texts}
    measured = {text: score for text, score in scores.items() if score is not None}
    if not measured:
        raise EvalError(f"no pair of {dataset} has the metric {metric!r}")
    best = sorted((text for text in measured if text != texts[0]), key=lambda text: -measured[text].mean)
    final = [*best[:top], texts[0]]
    reported = _run(final, dataset, protocol, resources, rest)
    reference = scene_means(reported.of(_DATASET, texts[0], "own"), metric)
    found = []
    for text in final:
        pairs = reported.of(_DATASET, text, "own")
        held_out = summarize(pairs, metric)
        if held_out is None:
            raise EvalError(f"no held-out pair of {dataset} has the metric {metric!r}")
        gain = paired_difference(reference, scene_means(pairs, metric))
        found.append(Trial(text, measured[text], held_out, gain, keypoints(having(pairs, metric))))
    return found


def _run(texts: list[str], dataset: str, protocol: Protocol, resources: Resources, scenes: list[str]) -> Results:
    methods = [MethodEntry(text, text) for text in texts]
    return run(Suite(methods, [DatasetEntry(_DATASET, dataset)], protocol=protocol), resources, scenes=scenes)


def table(found: list[Trial], metric: str) -> str:
    """Plain text, shares in percent."""
    lines = [f"{metric:>7} chosen  held out [95 %]        gain [95 %]             keypoints  method"]
    by = 100.0 if is_share(metric) else 1.0
    for t in found:
        held = f"{by * t.held_out.mean:5.1f} {_interval(by, t.held_out, '.0f')}"
        gain = f"{by * t.gain.mean:+5.1f} {_interval(by, t.gain, '+.1f')}"
        count = f"{t.count.mean:.0f} ({t.count.least})"
        lines.append(f"{by * t.tuned.mean:14.1f}  {held:22}  {gain:22}  {count:9}  {t.text}")
    return "\n".join(lines)


def _interval(by: float, of: Estimate | Difference, digits: str) -> str:
    """In brackets; nothing where there is none: a single scene has no spread."""
    return "" if math.isnan(of.low) else f"[{by * of.low:{digits}}, {by * of.high:{digits}}]"
