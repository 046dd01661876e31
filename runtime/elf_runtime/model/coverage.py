"""Which execution provider runs which node of a model, by ONNX Runtime's own profile."""

from __future__ import annotations

import json
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from elf_runtime.contract import ModelContract
from elf_runtime.errors import ElfError, ModelError, first_line

from .network import alone_feed
from .providers import Provider
from .session import open_session


@dataclass(frozen=True)
class Coverage:
    """What one provider ran of a model.

    Attributes
    ----------
    provider : str
    ran : dict
        Op -> number of nodes on this provider, as ONNX Runtime executes them: fused, with its layout changes;
        a provider that compiles whole subgraphs has one node for each.
    elsewhere : dict
        The provider that took the others -> op -> number of nodes.
    error : str
        Why nothing could be run; empty where it could.
    """

    provider: str
    ran: dict[str, int]
    elsewhere: dict[str, dict[str, int]]
    error: str = ""

    @property
    def complete(self) -> bool:
        return not self.error and not self.elsewhere and bool(self.ran)


def measure(model: str | Path, contract: ModelContract, provider: Provider) -> Coverage:
    """Run `model` once on a small image of noise and read where each node was executed.

    Nothing is concluded from lists of supported ops: whether a provider takes a node depends on its
    attributes and shapes too.

    Raises
    ------
    ModelError
        If the model itself can't be opened.
    """
    name = provider if isinstance(provider, str) else provider[0]
    feed = _noise(contract)
    with tempfile.TemporaryDirectory() as folder:
        try:
            session, _ = open_session(model, provider, profile=str(Path(folder) / "profile"))
            try:
                session.run(None, feed)
            finally:
                profile = session.end_profiling()
            events = json.loads(Path(profile).read_text(encoding="utf-8"))
        except ModelError:
            raise
        except ElfError as error:
            return Coverage(name, {}, {}, str(error))
        except Exception as error:  # onnxruntime's own exceptions share no base of theirs
            return Coverage(name, {}, {}, first_line(error))
    return from_events(name, events)


def _noise(contract: ModelContract) -> dict[str, npt.NDArray[Any]]:
    """The inputs of the graph, with a small image."""
    spec, form = contract.input, contract.end_to_end
    side = max(64, spec.min_size)
    shape = (1, *spec.size_for(side, side, 1.0), spec.channels)
    image = np.random.default_rng(0).random(shape, np.float32) * np.float32(spec.value_range)
    if form is None:
        return {spec.name: image}
    return alone_feed((image * (255 / spec.value_range)).astype(form.pixels), contract.detection)


def from_events(provider: str, events: list[dict[str, Any]]) -> Coverage:
    """The nodes of a profile of one run, by the provider that executed them."""
    by_provider: dict[str, Counter[str]] = {}
    for event in events:
        if event.get("cat") == "Node" and str(event.get("name", "")).endswith("_kernel_time"):
            details = event.get("args", {})
            by_provider.setdefault(details.get("provider", "unknown"), Counter())[details.get("op_name", "?")] += 1
    sorted_counts = {
        name: dict(sorted(counts.items(), key=lambda item: (-item[1], item[0]))) for name, counts in by_provider.items()
    }
    return Coverage(provider, sorted_counts.pop(provider, {}), sorted_counts)
