"""The paper's own figures."""

from __future__ import annotations

import pytest

from elf_eval.errors import EvalError
from elf_eval.suite import paper
from elf_eval.suite.suite import DatasetEntry, MethodEntry, Suite, TableEntry


def test_a_row_that_the_paper_does_not_have_is_never_a_blank():
    assert paper.figures(None, "HPatches") == "-"
    assert paper.figures("Sift", "HPatches") == "no row 'Sift'"
    with pytest.raises(EvalError, match=r"method 'mine': the paper has no row 'Sift'; it has .*'SIFT'"):
        Suite([MethodEntry("mine", "sift", paper="Sift")], [DatasetEntry("d", "x")])
    with pytest.raises(EvalError, match=r"table 'All': paper is one of .*'generic', 'gradients'.*, not 'all'"):
        TableEntry("All", paper="all")
