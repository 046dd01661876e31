"""The kinds of methods by name, and plugins."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from types import MappingProxyType

from elf_eval.errors import EvalError
from elf_eval.protocol import checked_ratio
from elf_eval.spec import Spec, boolean
from elf_runtime.errors import first_line, suggestion

from .elf import Elf
from .gradient import Gradient
from .lightglue import EXTRACTORS, LightGlueExtractor
from .method import Composed, Method
from .opencv import OPENCV, OpenCv
from .precomputed import Precomputed
from .xfeat import XFeat

Factory = Callable[[Spec, int | None], Method]

METHODS: Mapping[str, Factory] = MappingProxyType(
    {
        "elf": Elf,
        "sobel": Gradient,
        "laplacian": Gradient,
        "npz": Precomputed,
        "h5": Precomputed,
        "xfeat": XFeat,
        **dict.fromkeys(EXTRACTORS, LightGlueExtractor),
        **dict.fromkeys(OPENCV, OpenCv),
    }
)


def open_method(text: str, threads: int | None = None, shared: bool = False) -> Method:
    """The method that a text such as ``elf:vgg.onnx?preset=paper`` names.

    ``plugin:package.module.factory?...`` calls ``factory(spec, threads)`` of a module that can be imported.  The
    factory takes its options from the spec (`Spec.take`) and returns a `Method`.  Every kind has the options
    ``ratio=0.8`` and ``refine=true``, of the method's matches (`Method.ratio`, `Method.refine`).  `shared` is for many
    settings of few models: each model is opened once, and what its network gives for an image is computed once, while
    images are taken one after the other.

    Raises
    ------
    EvalError
        On an unknown kind or option, a missing file, a library that lacks the method, or a plugin that fails.
    """
    spec = Spec.parse(text)
    spec.shared = shared
    ratio = spec.take("ratio", _ratio, None)
    refine = spec.take("refine", boolean, None)
    factory = _plugin(spec) if spec.kind == "plugin" else METHODS.get(spec.kind)
    if factory is None:
        near = suggestion(spec.kind, METHODS)
        raise EvalError(f"{text}: unknown method {spec.kind!r}; known are {sorted(METHODS)} and plugin:...{near}")
    method = _made_by_plugin(factory, spec, threads) if spec.kind == "plugin" else factory(spec, threads)
    spec.finish()
    if ratio is not None:
        method.ratio = ratio
    if refine is not None:
        method.refine = refine
    return method


def _ratio(text: str) -> float:
    return checked_ratio(float(text))


def open_methods(
    detector: str, descriptor: str | None = None, threads: int | None = None, shared: bool = False
) -> Method:
    """A detector with its own descriptors, or with those of another method where `descriptor` names one."""
    first = open_method(detector, threads, shared)
    if descriptor is None or descriptor == detector:
        return first
    return Composed(first, open_method(descriptor, threads, shared))


def _plugin(spec: Spec) -> Factory:
    module, _, name = spec.argument.rpartition(".")
    try:
        factory: Factory = getattr(importlib.import_module(module), name)
    except Exception as error:  # whatever the module of somebody else raises
        raise EvalError(f"{spec.text}: can't import {spec.argument!r}: {first_line(error)}") from error
    return factory


def _made_by_plugin(factory: Factory, spec: Spec, threads: int | None) -> Method:
    try:
        method = factory(spec, threads)
    except EvalError:
        raise
    except Exception as error:
        raise EvalError(f"{spec.text}: {spec.argument} failed: {type(error).__name__}: {first_line(error)}") from error
    if not isinstance(method, Method):
        raise EvalError(f"{spec.text}: {spec.argument} returned no Method but {type(method).__name__}")
    if not isinstance(getattr(method, "fingerprint", None), str):
        raise EvalError(f"{spec.text}: the method has no fingerprint, a text that names what its features depend on")
    return method
