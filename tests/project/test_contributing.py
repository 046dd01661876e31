"""CONTRIBUTING's diff of a network is the network."""

from __future__ import annotations

from helpers import ROOT


def test_the_network_that_is_shown_is_the_one_there_is():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    diff = text.partition("```diff\n")[2].partition("```")[0]
    shown = [part.partition("\n") for part in diff.split("+++ ")[1:]]
    assert len(shown) == 2
    for name, _, body in shown:
        assert (ROOT / name).read_text() == "".join(line[1:] for line in body.splitlines(keepends=True))
