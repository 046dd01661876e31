"""The results of a run: one JSON file with every pair, its settings, versions and hashes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from elf_eval.errors import EvalError, reason
from elf_runtime.files.kind import open_regular
from elf_runtime.files.write import write_atomically

SCHEMA = 1


@dataclass(frozen=True)
class PairResult:
    """The metrics of one method on one pair of images; see `pair_metrics` for their names."""

    dataset: str
    scene: str
    first: str
    second: str
    method: str
    counts: str
    parameter: float | None
    metrics: Mapping[str, float | None]

    @property
    def pair(self) -> str:
        return f"{self.first} - {self.second}"


@dataclass(frozen=True)
class Results:
    """What a run found.

    Attributes
    ----------
    protocol : dict
    methods : list of dict
        name, detector, descriptor, paper, fingerprint, seconds_per_image (when the features were made).
    skipped : list of dict
        name and reason of the methods that could not be opened.
    datasets : list of dict
        name, spec, parameter, pairs, scenes, images, sha256 (over the images and the ground truth).
    versions : dict
    created : str
        ISO 8601, UTC.
    pairs : list of PairResult
    """

    protocol: dict[str, Any]
    methods: list[dict[str, Any]]
    skipped: list[dict[str, str]]
    datasets: list[dict[str, Any]]
    versions: dict[str, str]
    created: str
    pairs: list[PairResult]

    def save(self, path: Path) -> None:
        """Write JSON, one pair a line, so that two versions of the file can be compared."""
        head = {k: v for k, v in vars(self).items() if k != "pairs"}
        text = json.dumps({"schema": SCHEMA, **head}, indent=1)[:-2]
        rows = ",\n".join("  " + json.dumps(asdict(pair)) for pair in self.pairs)
        whole = f'{text},\n "pairs": [\n{rows}\n ]\n}}\n'
        write_atomically(path, lambda part: part.write_text(whole, encoding="utf-8"))

    @classmethod
    def load(cls, path: Path) -> Results:
        """Read what `save` wrote.

        Raises
        ------
        EvalError
            If the file is missing, does not hold results, or has another schema.
        """
        try:
            with open_regular(path) as file:
                data = json.loads(file.read())
            schema = data.pop("schema", None)
            if schema != SCHEMA:
                raise EvalError(f"{path}: results of schema {schema}, this version reads {SCHEMA}; run it again")
            data["pairs"] = [PairResult(**pair) for pair in data["pairs"]]
            found = cls(**data)
            _check(found)
            return found
        except OSError as error:
            raise EvalError(f"{path}: {reason(error)}") from error
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise EvalError(f"{path}: not a results file of elf-eval run") from error

    def of(self, dataset: str, method: str, counts: str) -> list[PairResult]:
        """One method's pairs on one dataset, by one way of counting."""
        return [p for p in self.pairs if (p.dataset, p.method, p.counts) == (dataset, method, counts)]


def _check(results: Results) -> None:
    """Raise TypeError where a part has the wrong type."""
    objects = [results.protocol, results.versions, *results.methods, *results.datasets]
    metrics = [value for pair in results.pairs for value in pair.metrics.values()]
    if not (isinstance(results.methods, list) and isinstance(results.datasets, list)):
        raise TypeError("methods and datasets are lists")
    if not all(isinstance(part, dict) for part in objects):
        raise TypeError("protocol, versions, methods and datasets hold objects")
    if not all(value is None or isinstance(value, (int, float)) for value in metrics):
        raise TypeError("metrics are numbers")
