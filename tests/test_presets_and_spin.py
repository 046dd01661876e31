"""What ElfRuntime chooses where the caller leaves it open: the file, the settings, how threads wait."""

from __future__ import annotations

import re
import time
from typing import Any

import pytest

from elf_runtime import PRESETS, DetectionParams, ElfRuntime, engine, preset
from elf_runtime.session import bundled_model, open_session
from helpers import TINY, textured


class Chosen(Exception):  # noqa: N818
    """What was to be opened."""


@pytest.mark.parametrize(
    ("providers", "precision"),
    [
        (None, "int8"),
        ("cpu", "int8"),
        ("CPU", "int8"),
        ("CPUExecutionProvider", "int8"),
        (["cpu"], "int8"),
        (("cpu", {"use_arena": "1"}), "int8"),
        ([("CPUExecutionProvider", {})], "int8"),
        ("cuda", "fp32"),
        (["cuda", "cpu"], "fp32"),
        (("openvino", {"device_type": "CPU"}), "fp32"),
        ([("TensorrtExecutionProvider", {}), "cpu"], "fp32"),
    ],
)
def test_the_bundled_file_suits_the_provider(monkeypatch: pytest.MonkeyPatch, providers: Any, precision: str) -> None:
    def opened(model: Any, **_: Any) -> None:
        raise Chosen(model)

    monkeypatch.setattr(engine, "open_session", opened)
    with pytest.raises(Chosen) as caught:
        ElfRuntime(providers=providers)
    assert caught.value.args == (bundled_model(precision),)


def test_a_file_of_the_user_s_is_taken_whatever_the_provider(monkeypatch: pytest.MonkeyPatch) -> None:
    def opened(model: Any, **_: Any) -> None:
        raise Chosen(model)

    monkeypatch.setattr(engine, "open_session", opened)
    with pytest.raises(Chosen) as caught:
        ElfRuntime(TINY, providers="cuda")
    assert caught.value.args == (TINY,)


def test_the_bundled_model_says_which_it_is() -> None:
    contract = ElfRuntime().contract
    assert contract.precision == "int8"
    assert ElfRuntime(bundled_model()).contract.precision == "fp32"


# -- presets -----------------------------------------------------------------------------------------------------


def test_the_presets_are_these() -> None:
    assert PRESETS == (
        "fast", "default", "accurate", "paper", "paper-webcam", "paper-robust", "paper-components"
    )  # fmt: skip
    common = {"normalize": 0.95, "nms_radius": 6, "subpixel": True}
    assert preset("fast") == DetectionParams(denoise=(3, 0.8), scale=0.28, **common)
    assert preset("default") == DetectionParams(denoise=(5, 1.2), scale=0.45, **common)
    assert preset("accurate") == DetectionParams(denoise=(7, 1.8), scale=0.75, **common)
    for name in ("fast", "default", "accurate"):
        assert preset(name, "xception") == preset(name)


def test_default_is_the_model_s_own() -> None:
    bundled = ElfRuntime()
    assert bundled.params("default") == bundled.params() == bundled.contract.detection == preset("default")
    tiny = ElfRuntime(TINY)
    assert tiny.contract.detection != preset("default")
    assert tiny.params("default") == tiny.params() == tiny.contract.detection
    assert tiny.params("fast") == preset("fast")
    assert tiny.params("default", nms_radius=3) == tiny.contract.detection.updated(nms_radius=3)


def test_the_presets_differ_in_what_the_network_sees() -> None:
    elf, image = ElfRuntime(threads=1), textured(240, 320)
    sizes = [elf.trace(image, preset=name).saliency.shape for name in ("fast", "default", "accurate")]
    assert sizes == [(67, 90), (108, 144), (180, 240)]


# -- threads that wait -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("spin", "within", "stops"), [(None, "1", "1"), (False, "0", "1"), (True, "1", "0")])
def test_spin_reaches_the_session(spin: bool | None, within: str, stops: str) -> None:
    session, _ = open_session(TINY, spin=spin)
    options = session.get_session_options()
    assert options.get_session_config_entry("session.intra_op.allow_spinning") == within
    assert options.get_session_config_entry("session.force_spinning_stop") == stops


@pytest.mark.parametrize("spin", [None, False])
def test_idle_threads_use_no_cpu(spin: bool | None) -> None:
    """Half a core, over 0.3 s, would be a thread that spins; the least of three, as other threads may be at work."""
    elf, image = ElfRuntime(TINY, threads=2, spin=spin), textured(240, 320)
    used = []
    for _ in range(3):
        elf.detect(image)
        start = time.process_time()
        time.sleep(0.3)
        used.append(time.process_time() - start)
    assert min(used) < 0.15


def test_the_docstring_names_the_presets() -> None:
    text = ElfRuntime.detect.__doc__ or ""
    assert set(re.findall(r'"([a-z-]+)"', text)) >= set(PRESETS)
