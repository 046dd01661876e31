"""What --compress may say, and the ranks that it comes to."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from elf_export import Compression, ExportError
from elf_export.compression.ranks import STEP, Candidate, of_energy, of_ratio


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("0.5", Compression(ratio=0.5)),
        ("energy=0.99", Compression(energy=0.99)),
        ("conv1_2=16,conv2_1=32", Compression(ranks={"conv1_2": 16, "conv2_1": 32})),
        ("/block=a/Conv=8", Compression(ranks={"/block=a/Conv": 8})),
    ],
)
def test_the_option_says_what_is_asked_for_and_is_said_again(text: str, wanted: Compression) -> None:
    assert Compression.parse(text) == wanted
    assert wanted.words() == ["--compress", text]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("half", "'half' is none of a ratio"),
        ("", "is none of a ratio"),
        ("conv1_2=", "is none of a ratio"),
        ("=16", "is none of a ratio"),
        ("energy=much", "is none of a ratio"),
        ("conv1_2=16,0.5", "is none of a ratio"),
        ("1.5", "ratio is a number between 0 and 1, not 1.5"),
        ("nan", "ratio is a number between 0 and 1, not nan"),
        ("energy=1", "energy is a number between 0 and 1, not 1"),
        ("conv1_2=16,conv1_2=20", "names a convolution twice"),
        ("conv1_2=0", "--compress conv1_2=0: at least 1 channel stays"),
    ],
)
def test_what_makes_no_sense_is_refused(text: str, message: str) -> None:
    with pytest.raises(ExportError, match=message):
        Compression.parse(text)


def test_one_thing_is_asked_for() -> None:
    for wrong in ({}, {"ratio": 0.5, "energy": 0.5}, {"ratio": 0.5, "ranks": {"a": 8}}):
        with pytest.raises(ExportError, match="one of a ratio, an energy, and ranks"):
            Compression(**wrong)


def candidate(decay: float, channels: int = 64, cells: float = 1.0) -> Candidate:
    return Candidate(decay ** np.arange(channels), cells * channels * 576.0, cells * (576.0 + channels))


CANDIDATES = {"steep": candidate(0.7), "gentle": candidate(0.97), "small": candidate(0.9, 32, 4.0)}


def test_options_are_the_steps_that_save_arithmetic() -> None:
    one = candidate(0.9)  # 64 channels: 57.6 of them cost as much as the whole
    assert one.options() == [56, 48, 40, 32, 24, 16, 8]
    assert Candidate(np.ones(4), 4 * 36.0, 40.0).options() == []


def test_the_least_rank_with_the_energy() -> None:
    found = of_energy(CANDIDATES, 0.95)
    for name, c in CANDIDATES.items():
        if name in found:
            assert c.energy(found[name]) >= 0.95 > c.energy(found[name] - STEP)
    assert found == {"steep": 16, "gentle": 56, "small": 24}
    # The others would need so many channels for more of it that nothing is saved.
    assert of_energy(CANDIDATES, 0.97) == {"steep": 16}


@pytest.mark.parametrize("ratio", [0.9, 0.6, 0.35])
def test_no_other_ranks_within_the_ratio_have_much_more_energy(ratio: float) -> None:
    """Against all combinations: a greedy search ends within a step of the best."""

    def told(ranks: dict[str, int]) -> tuple[float, float]:
        cost = sum(c.of_each * ranks[n] if n in ranks else c.whole for n, c in CANDIDATES.items())
        return cost, float(np.prod([CANDIDATES[n].energy(r) for n, r in ranks.items()]))

    limit = ratio * sum(c.whole for c in CANDIDATES.values())
    cost, energy = told(of_ratio(CANDIDATES, ratio))
    every = itertools.product(*([None, *c.options()] for c in CANDIDATES.values()))
    all_ranks = [{n: r for n, r in zip(CANDIDATES, some, strict=True) if r} for some in every]
    best = max(e for c, e in map(told, all_ranks) if c <= limit)
    assert cost <= limit
    assert energy >= 0.98 * best


def test_a_ratio_out_of_reach() -> None:
    with pytest.raises(ExportError, match=r"--compress 0\.1: ranks of 8, the smallest, take 0\.\d+ of the mult"):
        of_ratio(CANDIDATES, 0.1)


def test_what_never_varies_loses_nothing() -> None:
    assert of_energy({"flat": Candidate(np.zeros(64), 64 * 576.0, 640.0)}, 0.999) == {"flat": 8}
