"""Opening an .onnx file with ONNX Runtime: provider choice, threads, memory habits, and clear errors."""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import onnxruntime as ort

from elf_runtime.errors import ModelError, ProviderError, first_line, reason
from elf_runtime.files.kind import HEAD, description, open_regular
from elf_runtime.params import is_int

from .bundled import BUNDLED as BUNDLED
from .bundled import bundled_model as bundled_model
from .forking import opened

Provider = str | tuple[str, Mapping[str, Any]]

_SHORT_NAMES = {
    "cpu": "CPUExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
    "coreml": "CoreMLExecutionProvider",
    "directml": "DmlExecutionProvider",
    "xnnpack": "XnnpackExecutionProvider",
    "rocm": "ROCMExecutionProvider",
    "migraphx": "MIGraphXExecutionProvider",
    "qnn": "QNNExecutionProvider",
    "webgpu": "WebGpuExecutionProvider",
}


def is_cpu(providers: Provider | Sequence[Provider] | None) -> bool:
    """Whether ONNX Runtime's own CPU provider is asked for, and no other.

    Raises
    ------
    ProviderError
        If `providers` is of another type.
    """
    return all(_full_name(name) == "CPUExecutionProvider" for name, _ in _entries(providers or "cpu"))


def _entries(wanted: Provider | Sequence[Provider]) -> list[tuple[str, dict[str, Any] | None]]:
    """The providers as (name, options or None)."""
    pair = isinstance(wanted, tuple) and len(wanted) == 2 and isinstance(wanted[1], Mapping)
    entries: Sequence[Any] = [wanted] if isinstance(wanted, str) or pair else wanted
    found: list[tuple[str, dict[str, Any] | None]] = []
    for entry in entries if isinstance(entries, Sequence) else [entries]:
        if isinstance(entry, str):
            found.append((entry, None))
        elif isinstance(entry, Sequence) and len(entry) == 2 and isinstance(entry[0], str):
            if not isinstance(entry[1], Mapping):
                raise ProviderError(f"the options of provider {entry[0]!r} are a mapping, not {entry[1]!r}")
            found.append((entry[0], dict(entry[1])))
        else:
            raise ProviderError(f"a provider is a name, or a pair of a name and its options, not {entry!r}")
    return found


def _full_name(name: str) -> str:
    return _SHORT_NAMES.get(name.lower(), name)


def resolve_providers(wanted: Provider | Sequence[Provider] | None, fallback: bool) -> list[Provider]:
    """Full provider names, in order, each one known and installed.

    Parameters
    ----------
    wanted : str, (str, options) or a sequence of them, optional
        Short ("cuda") or full ("CUDAExecutionProvider") names, in order of preference.  None is the CPU.
    fallback : bool
        Leave out, with a RuntimeWarning, what is not installed, and run on the CPU where nothing is left.

    Raises
    ------
    ProviderError
        If a name is unknown to ONNX Runtime, or, without `fallback`, not in the installed build; or if `wanted` is of
        another type.
    """
    if wanted is None:
        return ["CPUExecutionProvider"]
    entries = _entries(wanted)
    if not entries:
        raise ProviderError("the list of providers is empty; leave it out to run on the CPU")
    available, known = ort.get_available_providers(), ort.get_all_providers()
    chosen: list[Provider] = []
    for name, options in entries:
        full = _full_name(name)
        if full not in known and full not in available:
            raise ProviderError(f"unknown provider {name!r}; installed are {available}")
        if full not in available:
            text = f"{full} is not in the installed onnxruntime {ort.__version__}, which has {available}"
            if not fallback:
                raise ProviderError(f"{text}. Install the build that has it, or take one of these")
            warnings.warn(text, RuntimeWarning, stacklevel=4)
            continue
        chosen.append(full if options is None else (full, options))
    return chosen or ["CPUExecutionProvider"]


def open_session(
    model: str | os.PathLike[str] | bytes,
    providers: Provider | Sequence[Provider] | None = None,
    threads: int | None = None,
    spin: bool | None = None,
    fallback: bool = False,
    profile: str | None = None,
    dims: Mapping[str, int] | None = None,
    optimize: bool = True,
    name: str = "<model bytes>",
) -> tuple[ort.InferenceSession, str]:
    """Open a model.

    Parameters
    ----------
    threads : int, optional
        Threads within an operator; None is one per physical core.
    spin : bool, optional
        Let idle threads spin within a run, for the short serial parts between parallel ones (None), never (False; right
        where other processes want the cores), or between runs as well (True; a core each).
    profile : str, optional
        File prefix for ONNX Runtime's profile.
    dims : mapping, optional
        Values for the model's symbolic dimensions, e.g. ``{"H": 480, "W": 640}``: the session then takes that size
        only, and ONNX Runtime fuses for it.  A model in ORT format ignores them.
    optimize : bool
        False opens a session in less than half the time, and memory, to check the model and look at its tensors.
    name : str
        How messages call a model that is given as bytes.

    Returns
    -------
    session, name : the session, and how error messages call the model

    Raises
    ------
    ModelError
        If the file is missing, empty, or not a valid ONNX model.
    ProviderError
        As `resolve_providers`; also if a provider is installed but does not start, unless `fallback`, and on `threads`
        or `spin` of another kind.
    """
    if threads is not None and (not is_int(threads) or threads < 1):
        raise ProviderError(f"threads is an integer >= 1, not {threads!r}")
    if spin is not None and not isinstance(spin, bool):
        raise ProviderError(f"spin is None, True or False, not {spin!r}")
    chosen = resolve_providers(providers, fallback)
    options = ort.SessionOptions()
    options.log_severity_level = 3
    if threads is not None:
        options.intra_op_num_threads = int(threads)
    options.add_session_config_entry("session.intra_op.allow_spinning", "0" if spin is False else "1")
    options.add_session_config_entry("session.force_spinning_stop", "0" if spin else "1")
    for dim, size in (dims or {}).items():
        options.add_free_dimension_override_by_name(dim, size)
    if not optimize:
        options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
        options.add_session_config_entry("session.disable_prepacking", "1")
    # A plan for a size is made in its second run, beside the arena of the first: half as much memory again and no
    # faster; and one would be kept for every image size ever seen.
    options.enable_mem_pattern = False
    if profile is not None:
        options.enable_profiling = True
        options.profile_file_prefix = profile
    source, name = _checked(model, name)
    try:
        session = opened(lambda: ort.InferenceSession(source, options, providers=chosen))
    except Exception as error:  # onnxruntime's own exceptions share no base of theirs
        if what := _description(source):
            raise ModelError(f"{name}: not an ONNX model: it is {what}") from error
        who = f"onnxruntime {ort.__version__}" if chosen == ["CPUExecutionProvider"] else str(_names(chosen))
        kind = ModelError if chosen == ["CPUExecutionProvider"] else ProviderError
        raise kind(f"{name}: {who} can't load it: {first_line(error)}") from error
    first, active = _names(chosen)[0], session.get_providers()
    if first not in active:
        text = f"{first} is installed but did not start (see onnxruntime's log); active are {active}"
        if not fallback:
            raise ProviderError(text)
        warnings.warn(text, RuntimeWarning, stacklevel=6)
    return session, name


def _names(providers: Sequence[Provider]) -> list[str]:
    return [p if isinstance(p, str) else p[0] for p in providers]


def read_model(model: str | os.PathLike[str] | bytes) -> tuple[bytes, str]:
    """The bytes of a model, and how messages call it.

    Raises
    ------
    ModelError
        If the file is missing, empty or can't be read.
    """
    source, name = _checked(model)
    if isinstance(source, bytes):
        return source, name
    try:
        with open_regular(source) as file:
            return file.read(), name
    except (OSError, MemoryError) as error:
        raise ModelError(f"{name}: {reason(error) or 'not enough memory to read it'}") from error


def _description(source: str | bytes) -> str | None:
    """What the file is, if not a model."""
    try:
        with open_regular(source) if isinstance(source, str) else io.BytesIO(source) as file:
            return description(file.read(HEAD))
    except OSError:
        return None


def _checked(model: str | os.PathLike[str] | bytes, name: str = "<model bytes>") -> tuple[str | bytes, str]:
    """The model as onnxruntime takes it and its name, after the checks that give the better message."""
    if isinstance(model, bytes):
        if not model:
            raise ModelError("the model is empty (0 bytes)")
        return model, name
    if not isinstance(model, (str, os.PathLike)):
        raise ModelError(f"a model is a path or bytes, not {type(model).__name__}")
    path = os.fsdecode(model)
    try:
        with open_regular(path) as file:
            size = os.fstat(file.fileno()).st_size
    except FileNotFoundError:
        raise ModelError(f"{path}: no such file") from None
    except OSError as error:
        raise ModelError(f"{path}: {reason(error)}") from error
    if size == 0:
        raise ModelError(f"{path}: the file is empty (0 bytes)")
    return path, path
