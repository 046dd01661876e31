"""Execution providers: which are taken, in which order, and one that is not installed."""

from __future__ import annotations

import numpy as np
import pytest

from elf_runtime import ElfRuntime, ProviderError
from elf_runtime.model.providers import computes_int8
from helpers import TINY, textured


def test_providers() -> None:
    assert ElfRuntime(TINY, providers="cpu").providers == ["CPUExecutionProvider"]
    assert ElfRuntime(TINY, providers=[("CPUExecutionProvider", {})]).providers == ["CPUExecutionProvider"]
    with pytest.raises(ProviderError, match="unknown provider 'warp'"):
        ElfRuntime(TINY, providers="warp")
    with pytest.raises(ProviderError, match="unknown provider 'warp'"):
        ElfRuntime(TINY, providers=["warp"], fallback=True)
    with pytest.raises(ProviderError, match="empty"):
        ElfRuntime(TINY, providers=[])
    for odd in (3, [3], ("cpu", None), {"cpu": {}}, [("cpu",)], b"cpu"):
        with pytest.raises(ProviderError, match="a provider is a name, or a pair of a name and its options"):
            ElfRuntime(TINY, providers=odd)  # type: ignore[arg-type]
    with pytest.raises(ProviderError, match="the options of provider 'cpu' are a mapping, not 3"):
        ElfRuntime(TINY, providers=[("cpu", 3)])  # type: ignore[list-item]
    for threads in (0, -1, 1.5, True):
        with pytest.raises(ProviderError, match="threads"):
            ElfRuntime(TINY, threads=threads)  # type: ignore[arg-type]
    assert len(ElfRuntime(TINY, threads=np.int64(2)).detect(textured(64, 80)))  # type: ignore[arg-type]
    for spin in ("yes", 1, 0):
        with pytest.raises(ProviderError, match=f"spin is None, True or False, not {spin!r}"):
            ElfRuntime(TINY, spin=spin)  # type: ignore[arg-type]


def test_the_bundled_model_is_in_8_bits_where_these_are_computed() -> None:
    gpu = {"device_type": "GPU"}
    eight = [None, "cpu", [("cpu", {})], "openvino", [("OpenVINOExecutionProvider", {"device_type": "CPU"}), "cpu"]]
    assert all(computes_int8(providers) for providers in eight)
    for providers in ("cuda", ["cuda", "cpu"], [("openvino", gpu), "cpu"], ["tensorrt", "openvino"]):
        assert not computes_int8(providers)  # type: ignore[arg-type]


def test_a_provider_that_is_not_installed() -> None:
    import onnxruntime

    missing = next(p for p in onnxruntime.get_all_providers() if p not in onnxruntime.get_available_providers())
    with pytest.raises(ProviderError, match=f"{missing} is not in the installed onnxruntime") as caught:
        ElfRuntime(TINY, providers=[missing, "cpu"])
    assert "fallback" not in str(caught.value)  # which no command has
    with pytest.warns(RuntimeWarning, match=missing):
        assert ElfRuntime(TINY, providers=[missing], fallback=True).providers == ["CPUExecutionProvider"]
