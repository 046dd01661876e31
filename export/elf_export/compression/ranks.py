"""How much of each convolution stays: what is asked for, and the ranks that it comes to."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from elf_export.errors import ExportError

STEP = 8  # ranks are multiples of it: ONNX Runtime's float kernels compute so many channels at a time, or twice as many


@dataclass(frozen=True)
class Compression:
    """What is asked for; exactly one of the three.

    Attributes
    ----------
    ratio : float in (0, 1), optional
        Of the multiply-adds of the convolutions that can be compressed, backward pass included.
    energy : float in (0, 1), optional
        Share of the variance of each convolution's responses that stays at least.
    ranks : mapping, optional
        Name of a convolution -> channels between its two parts; other convolutions stay as they are.
    """

    ratio: float | None = None
    energy: float | None = None
    ranks: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if (self.ratio is not None) + (self.energy is not None) + bool(self.ranks) != 1:
            raise ExportError("a compression is one of a ratio, an energy, and ranks of convolutions")
        for name in ("ratio", "energy"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < 1.0:
                raise ExportError(f"a compression's {name} is a number between 0 and 1, not {value:g}")
        for name, rank in self.ranks.items():
            if rank < 1:
                raise ExportError(f"--compress {name}={rank}: at least 1 channel stays")

    @classmethod
    def parse(cls, text: str) -> Compression:
        """What ``--compress`` says: "0.5", "energy=0.99" or "conv1_2=16,conv2_1=32".

        Raises
        ------
        ExportError
            On anything else.
        """
        try:
            if "=" not in text:
                return cls(ratio=float(text))
            pairs = [part.rpartition("=") for part in text.split(",")]
            if [name.strip() for name, _, _ in pairs] == ["energy"]:
                return cls(energy=float(pairs[0][2]))
            ranks = {name.strip(): int(value) for name, _, value in pairs}
            if len(ranks) < len(pairs):
                raise ExportError(f"--compress {text!r} names a convolution twice")
        except ValueError:
            ranks = {}
        if not all(ranks) or not ranks:
            raise ExportError(
                f"--compress {text!r} is none of a ratio of multiply-adds (0.5), an energy (energy=0.99), and ranks of "
                "convolutions (conv1_2=16,conv2_1=32)"
            )
        return cls(ranks=ranks)

    def __str__(self) -> str:
        if self.ratio is not None:
            return repr(self.ratio)
        if self.energy is not None:
            return f"energy={self.energy!r}"
        return ",".join(f"{name}={rank}" for name, rank in self.ranks.items())

    def words(self) -> list[str]:
        """The option of `elf-export` that says the same."""
        return ["--compress", str(self)]


@dataclass(frozen=True)
class Candidate:
    """A convolution of D channels as the choice of ranks sees it.

    Attributes
    ----------
    spectrum : (D,)
        Variances of its responses' principal components, the largest first.
    whole : float
        Multiply-adds as it is.
    of_each : float
        Multiply-adds for each channel of rank.
    """

    spectrum: npt.NDArray[np.float64]
    whole: float
    of_each: float

    def options(self) -> list[int]:
        """The multiples of STEP that save arithmetic, the largest first."""
        most = min(math.ceil(self.whole / self.of_each) - 1, len(self.spectrum))
        return list(range(most // STEP * STEP, 0, -STEP))

    def energy(self, rank: int) -> float:
        """Share of the variance in the first `rank` components."""
        total = float(self.spectrum.sum())
        return float(self.spectrum[:rank].sum()) / total if total > 0.0 else 1.0


def of_energy(candidates: Mapping[str, Candidate], energy: float) -> dict[str, int]:
    """The least rank of each convolution with so much of the variance; none where that saves nothing."""
    found = {name: [r for r in c.options() if c.energy(r) >= energy] for name, c in candidates.items()}
    return {name: min(ranks) for name, ranks in found.items() if ranks}


def of_ratio(candidates: Mapping[str, Candidate], ratio: float) -> dict[str, int]:
    """Ranks for a share of the multiply-adds, with as large a product of energies as a greedy search finds.

    Zhang's rank selection, section 3.4: from all convolutions whole, the next smaller rank is taken again and again
    where the logarithm of the energy falls least for each multiply-add that is saved.  Of equals the first.

    Raises
    ------
    ExportError
        If the smallest ranks take more than that.
    """
    whole = sum(c.whole for c in candidates.values())
    least = sum(min(c.of_each * STEP, c.whole) if c.options() else c.whole for c in candidates.values())
    if least > ratio * whole:
        raise ExportError(
            f"--compress {ratio:g}: ranks of {STEP}, the smallest, take {math.ceil(1000 * least / whole) / 1000:g} of "
            "the multiply-adds; choose a larger ratio"
        )
    ranks: dict[str, int] = {}
    spent = whole
    while spent > ratio * whole:
        steps = [_step(name, c, ranks.get(name)) for name, c in candidates.items()]
        _, name, rank, saved = min((s for s in steps if s is not None), key=lambda step: step[0])
        ranks[name] = rank
        spent -= saved
    return ranks


def _step(name: str, of: Candidate, rank: int | None) -> tuple[float, str, int, float] | None:
    """(energy lost for each multiply-add, name, the next smaller rank, multiply-adds saved); None at the smallest."""
    smaller: Sequence[int] = [r for r in of.options() if rank is None or r < rank]
    if not smaller:
        return None
    energy, cost = (1.0, of.whole) if rank is None else (of.energy(rank), of.of_each * rank)
    saved = cost - of.of_each * smaller[0]
    left = of.energy(smaller[0])
    lost = math.log(energy / left) if left > 0.0 else math.inf
    return lost / saved, name, smaller[0], saved
