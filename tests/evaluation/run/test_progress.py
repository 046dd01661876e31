"""Progress lines."""

from __future__ import annotations

import io

from elf_eval.run.progress import Progress


def test_progress_speaks_at_every_tenth_part_and_can_be_silent():
    loud, silent = io.StringIO(), io.StringIO()
    for stream, quiet in ((loud, False), (silent, True)):
        progress = Progress("stage", 40, stream, quiet)
        for i in range(40):
            progress.step(f"step {i}")
    assert len(loud.getvalue().splitlines()) == 10
    assert "stage 40/40" in loud.getvalue().splitlines()[-1]
    assert silent.getvalue() == ""
