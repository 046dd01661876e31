"""The results of a run: one JSON file with every pair, its settings, versions and hashes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from elf_eval.errors import EvalError, reason
from elf_eval.protocol import Protocol
from elf_runtime.files.kind import open_regular
from elf_runtime.files.write import write_atomically
from elf_runtime.plain import read_dataclass

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
    metrics: Mapping[str, int | float | None]

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
        name, detector, descriptor, paper, fingerprint, ratio (of its matches, None: no ratio test), refine (whether
        they are refined by the images), seconds_per_image (when the features were made).
    skipped : list of dict
        name and reason of the methods that could not be opened.
    datasets : list of dict
        name, spec, parameter, pairs, scenes, images, sha256 (over the images and the ground truth), published, paper
        (of the suite).
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
        except OSError as error:
            raise EvalError(f"{path}: {reason(error)}") from error
        except (ValueError, RecursionError) as error:
            raise EvalError(f"{path}: not a results file of elf-eval run: {error}") from error
        if isinstance(data, dict) and (schema := data.get("schema")) != SCHEMA:
            raise EvalError(f"{path}: results of schema {schema}, this version reads {SCHEMA}; run it again")
        try:
            checked = _checked(data)
        except (ValueError, EvalError) as error:
            raise EvalError(f"{path}: not a results file of elf-eval run: {error}") from error
        return cls(**{field.name: data[field.name] for field in fields(cls)} | {"pairs": checked.pairs})

    def of(self, dataset: str, method: str, counts: str) -> list[PairResult]:
        """One method's pairs on one dataset, by one way of counting."""
        return [p for p in self.pairs if (p.dataset, p.method, p.counts) == (dataset, method, counts)]


# What reports and comparisons read of a results file; it may hold more.


@dataclass(frozen=True)
class _Ransac:
    estimator: str
    threshold: float
    iterations: int
    confidence: float
    seed: int


@dataclass(frozen=True)
class _Protocol:
    size: tuple[int, int] | None
    max_keypoints: int
    eps: float
    counts: tuple[str, ...]
    homography: _Ransac
    pose: _Ransac
    count_floor: int = 0
    ratio: float | None = None
    refine: bool = False


@dataclass(frozen=True)
class _Method:
    name: str
    paper: str | None
    ratio: float | None = None
    refine: bool = False


@dataclass(frozen=True)
class _Skipped:
    name: str
    reason: str


@dataclass(frozen=True)
class _Dataset:
    name: str
    parameter: str | None
    pairs: int
    scenes: int
    sha256: str
    paper: str = ""


@dataclass(frozen=True)
class _File:
    protocol: _Protocol
    methods: list[_Method]
    skipped: list[_Skipped]
    datasets: list[_Dataset]
    versions: dict[str, str]
    created: str
    pairs: list[PairResult]


def _checked(data: Any) -> _File:
    """A results file's data, with all that is read of it there and of its type.

    Raises
    ------
    ValueError, EvalError
        Saying what is wrong where.
    """
    found = read_dataclass(_File, data, ignore_unknown=True)
    Protocol.from_dict(asdict(found.protocol))
    return found
