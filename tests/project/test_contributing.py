"""CONTRIBUTING's diffs, of a rule and of a network, are the files."""

from __future__ import annotations

import re

import pytest

from helpers import ROOT

DIFFS = re.findall(r"```diff\n(.*?)```", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), re.DOTALL)


def test_there_is_one_of_a_rule_and_one_of_a_network():
    assert len(DIFFS) == 2


@pytest.mark.parametrize("diff", DIFFS, ids=["rule", "network"])
def test_what_is_shown_is_what_there_is(diff: str):
    parts = re.findall(r"^--- /dev/null\n\+\+\+ b/(\S+)\n@@ -0,0 \+1,(\d+) @@\n((?:\+.*\n)+)", diff, re.MULTILINE)
    assert "".join(f"--- /dev/null\n+++ b/{n}\n@@ -0,0 +1,{c} @@\n{body}" for n, c, body in parts) == diff
    assert len(parts) == 2  # the code and its test's row
    for name, count, body in parts:
        lines = [line[1:] for line in body.splitlines()]
        assert lines == (ROOT / name).read_text(encoding="utf-8").splitlines()
        assert int(count) == len(lines)
