"""One mutant, tried in a process of its own: what came out, how long it took, how much memory it needed."""

from __future__ import annotations

import contextlib
import faulthandler
import io
import os
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass

from elf_runtime import ElfError

SECONDS, BYTES = 20.0, 1.5e9
_TAKEN, _REFUSED, _WRONG = 0, 10, 20  # exit statuses of the child


@dataclass(frozen=True)
class Outcome:
    """`fault` is empty where the mutant was taken, or refused by an error of ours in one line.

    `bytes` is what it needed beyond what the child had when it began.
    """

    what: str
    refused: bool
    fault: str
    seconds: float
    bytes: float


def trial(what: str, work: Callable[[], None]) -> Outcome:
    """Do `work` in a forked child: it may end, or raise an `ElfError`; all else is a fault."""
    begun = time.monotonic()
    with tempfile.TemporaryFile() as said:
        begins, ends = os.pipe()
        child = os.fork()
        if child == 0:
            os.write(ends, f"{resident()}\n".encode())
            os._exit(_in_child(work, said.fileno()))
        os.close(ends)
        with os.fdopen(begins) as first:
            before = float(first.readline())
        status = None
        while status is None and time.monotonic() - begun < SECONDS:
            done, raw, usage = os.wait4(child, os.WNOHANG)
            if done:
                status, peak = raw, usage.ru_maxrss * 1024.0 - before
            else:
                time.sleep(0.002)
        seconds = time.monotonic() - begun
        if status is None:
            os.kill(child, signal.SIGKILL)
            usage = os.wait4(child, 0)[2]
            return Outcome(what, False, f"no end within {SECONDS:g} s", seconds, usage.ru_maxrss * 1024.0 - before)
        said.seek(0)
        text = said.read().decode(errors="replace")
    if os.WIFSIGNALED(status):
        fault = f"signal {signal.Signals(os.WTERMSIG(status)).name}"
    elif os.WEXITSTATUS(status) in (_TAKEN, _REFUSED):
        fault = f"{peak / 2**20:.0f} MiB" if peak > BYTES else ""
    else:
        fault = text or f"exit status {os.WEXITSTATUS(status)}"
    return Outcome(what, os.WEXITSTATUS(status) == _REFUSED, fault, seconds, peak)


def resident() -> float:
    """Bytes that this process has in memory; 0 where the system does not say."""
    try:
        with open("/proc/self/statm", encoding="ascii") as statm:
            return float(statm.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0.0


def _in_child(work: Callable[[], None], said: int) -> int:
    # What libraries print goes nowhere; a fault's text goes to the parent.
    faulthandler.disable()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    try:
        work()
    except ElfError as error:
        text = str(error)
        odd = [c for c in text if not c.isprintable() and c != "\n"]
        if not text.strip() or odd or len(text) > 11_000:
            os.write(said, f"an error of {len(text)} characters, {odd[:3]} among them: {text[:300]!r}".encode())
            return _WRONG
        return _REFUSED
    except BaseException:  # the fault that is looked for
        os.write(said, traceback.format_exc()[-3000:].encode(errors="replace"))
        return _WRONG
    return _TAKEN


def command(main: Callable[[list[str]], int], arguments: list[str]) -> None:
    """Run a command: it must end with 0, or with 1 or 2 and an error in one line.

    Raises
    ------
    ElfError
        Where it refuses, as it should.
    """
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status = main(arguments)
        except SystemExit as end:
            status = int(end.code or 0)
    lines = [line for line in err.getvalue().splitlines() if not line.startswith("  ")]  # the rows of a list
    if status == 0:
        return
    if status not in (1, 2) or not any(": error: " in line for line in lines):
        raise AssertionError(f"status {status}, said {err.getvalue()[-1500:]!r}")
    if "Traceback" in err.getvalue():
        raise AssertionError(err.getvalue()[-3000:])
    raise ElfError(lines[0])


if __name__ == "__main__":
    sys.exit("run: python -m mutants")
