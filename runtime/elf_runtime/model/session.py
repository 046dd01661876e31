"""Opening an .onnx file with ONNX Runtime: threads, memory habits, and clear errors."""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Mapping, Sequence

import onnxruntime as ort

from elf_runtime.errors import ModelError, ProviderError, first_line, reason
from elf_runtime.files.kind import HEAD, description, open_regular
from elf_runtime.values import is_int

from .forking import opened
from .providers import Provider, provider_names, resolve_providers


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
        Name, in messages, of a model that is given as bytes.

    Returns
    -------
    session, name : the session, and the model's name for messages

    Raises
    ------
    ModelError
        If the file is missing, empty, or not a valid ONNX model.
    ProviderError
        As `resolve_providers`; also if a provider is installed but does not start, unless `fallback`, and on `threads`
        or `spin` of another kind.
    """
    chosen = resolve_providers(providers, fallback)
    options = _options(threads, spin, profile, dims or {}, optimize)
    source, name = _checked(model, name)
    first, on_cpu = provider_names(chosen)[0], chosen == ["CPUExecutionProvider"]
    try:
        session = opened(lambda: ort.InferenceSession(source, options, providers=chosen))
    except Exception as error:  # onnxruntime's own exceptions share no base of theirs
        if what := _description(source):
            raise ModelError(f"{name}: not an ONNX model: it is {what}") from error
        who = f"onnxruntime {ort.__version__}" if on_cpu else str(provider_names(chosen))
        raise (ModelError if on_cpu else ProviderError)(f"{name}: {who} can't load it: {first_line(error)}") from error
    active = session.get_providers()
    if first not in active:
        text = f"{first} is installed but did not start (see onnxruntime's log); active are {active}"
        if not fallback:
            raise ProviderError(text)
        warnings.warn(text, RuntimeWarning, stacklevel=6)
    return session, name


def _options(
    threads: int | None, spin: bool | None, profile: str | None, dims: Mapping[str, int], optimize: bool
) -> ort.SessionOptions:
    if threads is not None and (not is_int(threads) or threads < 1):
        raise ProviderError(f"threads is an integer >= 1, not {threads!r}")
    if spin is not None and not isinstance(spin, bool):
        raise ProviderError(f"spin is None, True or False, not {spin!r}")
    options = ort.SessionOptions()
    options.log_severity_level = 3
    if threads is not None:
        options.intra_op_num_threads = int(threads)
    options.add_session_config_entry("session.intra_op.allow_spinning", "0" if spin is False else "1")
    options.add_session_config_entry("session.force_spinning_stop", "0" if spin else "1")
    for dim, size in dims.items():
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
    return options


def read_model(model: str | os.PathLike[str] | bytes) -> tuple[bytes, str]:
    """The bytes of a model, and its name for messages.

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
    """The model as onnxruntime takes it, and its name, after checks whose messages are better than onnxruntime's."""
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
