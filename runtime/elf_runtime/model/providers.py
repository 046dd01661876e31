"""ONNX Runtime's execution providers: what a user calls them, and which of them are there."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import onnxruntime as ort

from elf_runtime.errors import ProviderError, suggestion

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


def computes_int8(providers: Provider | Sequence[Provider] | None) -> bool:
    """Whether the preferred provider computes in 8-bit integers: ONNX Runtime's own on CPUs, and OpenVINO there.

    Others, as far as they are known, convolve in floats, with roundings in between.  docs/providers.md has the times.
    """
    if is_cpu(providers):
        return True
    (name, options), *_ = _entries(providers or "cpu")
    device = str((options or {}).get("device_type", "CPU"))
    return _full_name(name) == "OpenVINOExecutionProvider" and device.startswith("CPU")


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
            raise ProviderError(f"unknown provider {name!r}; installed are {available}{_near(name, known)}")
        if full not in available:
            text = f"{full} is not in the installed onnxruntime {ort.__version__}, which has {available}"
            if not fallback:
                raise ProviderError(f"{text}. Install the build that has it, or take one of these")
            warnings.warn(text, RuntimeWarning, stacklevel=4)
            continue
        chosen.append(full if options is None else (full, options))
    return chosen or ["CPUExecutionProvider"]


def _near(name: str, known: Sequence[str]) -> str:
    return suggestion(name, [word for full in known for word in (full, full.removesuffix("ExecutionProvider").lower())])


def provider_names(providers: Sequence[Provider]) -> list[str]:
    """The names alone."""
    return [p if isinstance(p, str) else p[0] for p in providers]
