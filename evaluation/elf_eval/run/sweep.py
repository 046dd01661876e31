"""A sweep: settings are chosen on some scenes and reported on the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from elf_eval.data import open_dataset
from elf_eval.errors import EvalError
from elf_eval.metrics.families import check_metrics, metric_names
from elf_eval.metrics.intervals import Difference, Estimate, paired_difference
from elf_eval.protocol import Protocol
from elf_eval.suite.suite import DatasetEntry, MethodEntry, Suite

from .averages import Keypoints, having, keypoints, scene_means, summarize
from .results import Results
from .runner import Resources, run

_DATASET = "sweep"


@dataclass(frozen=True)
class Trial:
    """One setting, with its metric on the scenes where it was chosen and on the others.

    Attributes
    ----------
    text : str
        The method, as ``elf:vgg.onnx?denoise=5,2``.
    tuned : Estimate
    held_out : Estimate
    gain : Difference
        On the held-out scenes, over the first model with its own settings.
    count : Keypoints
        On the held-out scenes, over the pairs that have the metric.
    """

    text: str
    tuned: Estimate
    held_out: Estimate
    gain: Difference
    count: Keypoints


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
    texts: Sequence[str],
    dataset: str,
    metric: str,
    top: int,
    protocol: Protocol,
    resources: Resources,
    tune: list[str] | None = None,
    beside: Sequence[str] = (),
) -> list[Trial]:
    """Rank methods by `metric` on one part of the scenes; measure the `top` and the first on the other part.

    Parameters
    ----------
    texts : sequence of str
        The methods; the first one is the reference.
    beside : sequence of str
        Methods that are measured on both parts but take no part in the choice, such as the paper's own settings.

    Returns
    -------
    list of Trial
        The best first, by the scenes where they were chosen; then those beside, and the reference last.

    Raises
    ------
    EvalError
        If the dataset or the methods don't give the metric; where it is the dataset, before any work.  If `protocol`
        is without each method's own counts, by which a sweep chooses.
    """
    if "own" not in protocol.counts:
        raise EvalError("a sweep chooses by each method's own counts: --counts own, or leave it out")
    opened = open_dataset(dataset)
    known = dict.fromkeys(name for pair in opened.pairs for name in metric_names(pair.truth))
    check_metrics([metric], known, f"a run on {dataset} has")
    chosen, rest = split(opened.scenes(), tune)
    apart = [text for text in dict.fromkeys(beside) if text not in texts]
    tuned = _run([*texts, *apart], dataset, protocol, resources, chosen)
    scores = {text: summarize(tuned.of(_DATASET, text, "own"), metric) for text in [*texts, *apart]}
    measured = {text: score for text, score in scores.items() if score is not None}
    if not measured:
        raise EvalError(f"no pair of {dataset} has the metric {metric!r}")
    tried = (text for text in measured if text != texts[0] and text not in apart)
    best = sorted(tried, key=lambda text: -measured[text].mean)
    final = list(dict.fromkeys([*best[:top], *(text for text in beside if text in measured), texts[0]]))
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


def _run(texts: Sequence[str], dataset: str, protocol: Protocol, resources: Resources, scenes: list[str]) -> Results:
    methods = [MethodEntry(text, text) for text in texts]
    suite = Suite(methods, [DatasetEntry(_DATASET, dataset)], protocol=protocol)
    return run(suite, resources, scenes=scenes, shared=True)
