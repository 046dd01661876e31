"""A suite: methods, datasets, protocol, and the tables and pictures to make of them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

from elf_eval.errors import EvalError
from elf_eval.protocol import Protocol

from . import variables
from .paper import PAPER, TABLES
from .paper_logs import EXPERIMENTS


@dataclass(frozen=True)
class MethodEntry:
    """A method, and the name that it has in the tables.

    Attributes
    ----------
    name : str
    detector : str
    descriptor : str, optional
        The detector's own where absent.
    paper : str, optional
        The row of the paper's tables that stands beside it.
    optional : bool
        Where it can't be opened, leave it out, and say why in the report.
    family : str
        Methods of one family have the same marker in `elf-eval pareto`.
    keypoints_of : str, optional
        The method above whose keypoints this one describes: a run that finds others in its files ends there.
    """

    name: str
    detector: str
    descriptor: str | None = None
    paper: str | None = None
    optional: bool = False
    family: str = "methods"
    keypoints_of: str | None = None

    def __post_init__(self) -> None:
        if self.paper is not None and self.paper not in PAPER:
            raise EvalError(f"method {self.name!r}: the paper has no row {self.paper!r}; it has {list(PAPER)}")


@dataclass(frozen=True)
class DatasetEntry:
    """A dataset, and the name that it has in the tables.

    Attributes
    ----------
    name, spec : str
    optional : bool
        Where it can't be opened, leave it out, and say why in the report.
    published : mapping
        How many "pairs" and "scenes" the paper's figures are over, where known; the report says where ours differ.
    paper : str
        Which of the paper's experiments stands beside: a name of `paper_logs.EXPERIMENTS`.  By default "scale" or
        "rotation" where its pairs vary in that, and else "generic", HPatches and Webcam.
    """

    name: str
    spec: str
    optional: bool = False
    published: dict[str, int] = field(default_factory=dict)
    paper: str = ""

    def __post_init__(self) -> None:
        if self.paper and self.paper not in EXPERIMENTS:
            raise EvalError(f"dataset {self.name!r}: paper is one of {list(EXPERIMENTS)}, not {self.paper!r}")
        if unknown := set(self.published) - {"pairs", "scenes"}:
            raise EvalError(f"dataset {self.name!r}: published has pairs and scenes, not {sorted(unknown)}")


@dataclass(frozen=True)
class TableEntry:
    """A table and its plot; an empty list of methods or datasets means all.

    Attributes
    ----------
    plot : "bars", "curves" (over the pairs' parameter) or "mma"
    note : str
        A paragraph above the table.
    paper : a name of `paper.TABLES`, optional
        The paper's table whose other rows, those that ours has no method for, stand below, once for each dataset.
    """

    title: str
    datasets: list[str] = field(default_factory=list)
    methods: list[str] = field(default_factory=list)
    plot: str = "bars"
    note: str = ""
    paper: str = ""

    def __post_init__(self) -> None:
        if self.plot not in ("bars", "curves", "mma"):
            raise EvalError(f"table {self.title!r}: plot is 'bars', 'curves' or 'mma', not {self.plot!r}")
        if self.paper and self.paper not in TABLES:
            raise EvalError(f"table {self.title!r}: paper is one of {sorted(TABLES)}, not {self.paper!r}")


@dataclass(frozen=True)
class PictureEntry:
    """A picture of matches; ``pair`` is "v_graf/1.png - v_graf/3.png", and an empty list of methods means all."""

    dataset: str
    pair: str
    methods: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Suite:
    """Everything that one run does.

    Attributes
    ----------
    variables : dict
        What ``${NAME}`` means in the methods' and datasets' texts, unless there is an environment variable NAME.
    groups : dict
        Names of groups of scenes, for tables by group.
    """

    methods: list[MethodEntry]
    datasets: list[DatasetEntry]
    title: str = "Evaluation"
    note: str = ""
    protocol: Protocol = field(default_factory=Protocol)
    tables: list[TableEntry] = field(default_factory=list)
    pictures: list[PictureEntry] = field(default_factory=list)
    variables: dict[str, str] = field(default_factory=dict)
    groups: dict[str, list[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.methods or not self.datasets:
            raise EvalError("a run needs at least one method and one dataset")
        methods = _unique([m.name for m in self.methods], "method")
        datasets = _unique([d.name for d in self.datasets], "dataset")
        for number, method in enumerate(self.methods):
            above = [m.name for m in self.methods[:number]]
            if method.keypoints_of is not None and method.keypoints_of not in above:
                raise EvalError(f"method {method.name!r}: keypoints_of {method.keypoints_of!r} is no method above it")
        for table in self.tables:
            _known(table.methods, methods, f"table {table.title!r}: method")
            _known(table.datasets, datasets, f"table {table.title!r}: dataset")
        for picture in self.pictures:
            _known([picture.dataset], datasets, f"picture {picture.pair!r}: dataset")
            _known(picture.methods, methods, f"picture {picture.pair!r}: method")

    def expand(self, text: str) -> str:
        """`text` with its ``${NAME}`` replaced; EvalError where one is not set (`variables.expand`)."""
        return variables.expand(text, self.variables)

    def texts(self, entry: MethodEntry) -> tuple[str, str | None]:
        """The method's detector and descriptor, expanded."""
        return self.expand(entry.detector), self.expand(entry.descriptor) if entry.descriptor else None

    def origin(self, entry: MethodEntry | DatasetEntry) -> str:
        """What the entry's ``${NAME}`` mean, in brackets, to stand behind an error's text (`variables.origin`)."""
        texts = [entry.spec] if isinstance(entry, DatasetEntry) else [entry.detector, entry.descriptor or ""]
        return variables.origin(" ".join(texts), self.variables)

    def unexpand(self, text: str) -> str:
        """`text` with names for the variables' values, because a report should not depend on where files lie."""
        return variables.unexpand(text, self.variables)

    def check_groups(self, scenes: Collection[str]) -> None:
        """Refuse a group without a scene among `scenes`, those of the datasets; some of a group may be absent."""
        for group, names in self.groups.items():
            if not set(names) & set(scenes):
                raise EvalError(f"[groups] {group}: none of {names} is in the datasets; there are {sorted(scenes)}")


def _unique(names: list[str], what: str) -> set[str]:
    if doubles := {n for n in names if names.count(n) > 1}:
        raise EvalError(f"two {what}s of the same name: {sorted(doubles)}")
    return set(names)


def _known(names: list[str], known: set[str], what: str) -> None:
    if unknown := [n for n in names if n not in known]:
        raise EvalError(f"{what} {unknown} is not in the suite; there are {sorted(known)}")
