"""What a gradient is while it travels back through the graph: one value, or its four phases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

ADJOINT = "adj/"  # what the names of its nodes begin with
PHASES = ((0, 0), (0, 1), (1, 0), (1, 1))  # row and column of each of four, in the order that they are held in


class Extent(Enum):
    """How many rows the phases of a map of H rows have, and columns likewise; see `Phases`."""

    FLOOR = "H // 2"  # as floor-mode pooling leaves them: what it drops is zero and not held
    CEIL = "(H + 1) // 2"
    BEYOND = "H // 2 + 1"


@dataclass(frozen=True)
class Phases:
    """A gradient v of the shape of the forward value `like`, (N, C, H, W).

    Attributes
    ----------
    pieces : four values, or one with all of them side by side along the channels
        v_00, v_01, v_10, v_11, each (N, C, h, w).
    extent : Extent
        Of h and w.  One piece, which is only put together and cut, may be of BEYOND along one axis and of CEIL along
        the other; it is then said to be of BEYOND.
    clean : bool
        Whether what the pieces hold beyond H and W is zero.
    zero_unless_positive : str, optional
        A forward value; v is zero wherever it is not positive.
    step : int
        Places from one value of a phase to the next.  One piece holds step^2 phases.
    """

    pieces: tuple[str, ...]
    like: str
    extent: Extent = Extent.FLOOR
    clean: bool = True
    zero_unless_positive: str | None = None
    step: int = 2


class Rectified(str):
    """Name of a gradient, in one piece, that is zero wherever the forward value `unless_positive` is not positive."""

    unless_positive: str

    def __new__(cls, name: str, unless_positive: str) -> Rectified:
        made = super().__new__(cls, name)
        made.unless_positive = unless_positive
        return made


Part = str | Phases

Gradients = Sequence[Part | None]
"""One gradient per input of the node, None where it gets none; trailing Nones may be left out."""
