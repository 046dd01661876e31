"""Interrupted runs go on, and damaged lines are not believed."""

from __future__ import annotations

import pytest
from scenes import same

from elf_eval.run.runner import run


@pytest.mark.parametrize(
    "line",
    [
        b"5",
        b'["a", "b"]',
        b"[[1], {}, 3]",
        b"\xff\xfe",
        b"[" * 100000,
        b"null",
        b'[123456, "key", {"rep": 1.0}]',
    ],
)
def test_a_damaged_resume_line_is_told_once_and_evaluated_again(
    line, suite, resources, tmp_path, interrupted_at, capsys
):
    log = tmp_path / "log.jsonl"
    complete = run(suite, resources, log)
    lines = log.read_bytes().splitlines()
    log.write_bytes(b"\n".join([lines[0], line, *lines[2:]]) + b"\n")
    calls = interrupted_at(99)
    assert same(run(suite, resources, log), complete)
    say = f"elf-eval: {log}: 1 of {len(lines)} lines are damaged; their pairs are evaluated again\n"
    assert capsys.readouterr().err == say
    assert len(calls) == 1
    assert same(run(suite, resources, log), complete)
    assert capsys.readouterr().err == ""
    assert len(calls) == 1


def test_a_resume_line_with_another_figure_is_not_believed(suite, resources, tmp_path):
    log = tmp_path / "log.jsonl"
    complete = run(suite, resources, log)
    text = log.read_text()
    changed = text.replace('"n1": 60', '"n1": 61', 1)
    assert changed != text
    log.write_text(changed)
    assert same(run(suite, resources, log), complete)


def test_an_interrupted_run_goes_on(suite, resources, tmp_path, interrupted_at):
    log = tmp_path / "log.jsonl"
    complete = run(suite, resources)
    calls = interrupted_at(7)
    with pytest.raises(KeyboardInterrupt):
        run(suite, resources, log)
    assert len(log.read_text().splitlines()) == 6
    with open(log, "a") as file:
        file.write('["half a li')
    resumed = run(suite, resources, log)
    assert len(calls) - 7 == len(complete.pairs) - 6
    assert same(resumed, complete)
