"""What only a fresh process can tell: how long the import and loading a model take, and how much memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from statistics import median
from typing import Any

import elf_runtime
from elf_runtime.errors import ElfError
from elf_runtime.model.providers import Provider
from elf_runtime.params import DetectionParams

# Peak memory is the kernel's high-water mark of the address space, where there is one: Linux hands ru_maxrss
# on across fork and exec, so that a small process started by a large one would report the large one's.
_SCRIPT = """
import json, sys, time
start = time.perf_counter()
import elf_runtime
imported = time.perf_counter()
options = json.loads(sys.argv[1])
provider = options["provider"]
provider = tuple(provider) if isinstance(provider, list) else provider
elf = elf_runtime.ElfRuntime(options["model"], providers=provider, threads=options["threads"])
loaded = time.perf_counter()

def peak():
    try:
        with open("/proc/self/status") as status:
            return next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        pass
    try:
        import resource
    except ImportError:
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)

result = {"import_s": imported - start, "load_s": loaded - imported, "peak_loaded_bytes": peak()}
if options["size"]:
    params = options["params"] and elf_runtime.DetectionParams.from_dict(options["params"])
    begin = time.perf_counter()
    elf.warmup(tuple(options["size"]), params=params)
    result["first_detect_s"] = time.perf_counter() - begin
    # onnxruntime may plan its memory, and take it, after the first run only
    elf.warmup(tuple(options["size"]), params=params)
    result["peak_detect_bytes"] = peak()
print(json.dumps(result))
"""


def start_up(model: str | None, provider: Provider | None, threads: int, repeats: int) -> dict[str, float]:
    """Median seconds of ``import elf_runtime`` and of loading the model, over fresh processes."""
    runs = [_run(model, provider, threads, None) for _ in range(repeats)]
    return {
        "processes": repeats,
        "import_s": median(run["import_s"] for run in runs),
        "load_s": median(run["load_s"] for run in runs),
    }


def peak_memory(
    model: str | None,
    provider: Provider | None,
    threads: int,
    size: tuple[int, int],
    params: DetectionParams | None = None,
) -> dict[str, float | None]:
    """Peak resident bytes of a fresh process: model loaded, and after two detections at `size` (H, W)."""
    run = _run(model, provider, threads, size, params)
    return {key: run[key] for key in ("peak_loaded_bytes", "peak_detect_bytes", "first_detect_s")}


def _run(
    model: str | None,
    provider: Provider | None,
    threads: int,
    size: tuple[int, int] | None,
    params: DetectionParams | None = None,
) -> dict[str, Any]:
    options = {
        "model": model,
        "provider": provider,
        "threads": threads,
        "size": size,
        "params": params.to_dict() if params else None,
    }
    # The child must find the package that runs here, even if it is not installed.
    package = str(Path(elf_runtime.__file__).resolve().parents[1])
    known = os.environ.get("PYTHONPATH")
    env = {**os.environ, "PYTHONPATH": package + (os.pathsep + known if known else "")}
    command = [sys.executable, "-c", _SCRIPT, json.dumps(options)]
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        reason = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise ElfError(f"a fresh process failed with status {done.returncode}: {reason}")
    result: dict[str, Any] = json.loads(done.stdout)
    return result
