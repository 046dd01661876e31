"""What ElfRuntime chooses where the caller leaves it open: the file, the settings, how threads wait."""

from __future__ import annotations

import re
import time
from typing import Any

import numpy as np
import onnxruntime as ort
import pytest

from elf_runtime import PRESETS, DetectionParams, ElfRuntime, ProviderError, preset
from elf_runtime.model import bundled_model, sessions
from elf_runtime.model.providers import resolve_providers
from elf_runtime.model.session import open_session
from helpers import TINY, textured


class Chosen(Exception):  # noqa: N818
    """The model that was to be opened."""


def chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every known provider be installed, and opening a model raise its name."""

    def opened(model: Any, *, name: str, **_: Any) -> None:
        raise Chosen(name)

    monkeypatch.setattr("elf_runtime.model.session.ort.get_available_providers", ort.get_all_providers)
    monkeypatch.setattr(sessions, "open_session", opened)


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
        (("openvino", {"device_type": "CPU"}), "int8"),
        (("openvino", {"device_type": "GPU"}), "fp32"),
        ([("TensorrtExecutionProvider", {}), "cpu"], "fp32"),
    ],
)
def test_the_bundled_file_suits_the_provider(monkeypatch: pytest.MonkeyPatch, providers: Any, precision: str) -> None:
    chosen(monkeypatch)
    with pytest.raises(Chosen) as caught:
        ElfRuntime(providers=providers)
    assert caught.value.args == (str(bundled_model(precision)),)


@pytest.mark.parametrize("name", ["fast", "default", "accurate", "multiscale"])
@pytest.mark.parametrize("ground", [(200, 150, 100), (60, 160, 220)])
def test_the_edge_of_a_plain_coloured_image_is_no_keypoint(name: str, ground: tuple[int, int, int]) -> None:
    """The network's zero padding is an edge there, which the presets' borders leave out."""
    image = np.full((480, 640, 3), ground, np.uint8)
    image[165:265, 245:395] = textured(100, 150)
    found = ElfRuntime(threads=1).detect(image, preset=name).keypoints
    inside = ((found > 60) & (found < (640 - 60, 480 - 60))).all(axis=1)
    assert len(found) > 40
    assert inside.all()


def test_a_file_of_the_user_s_is_taken_whatever_the_provider(monkeypatch: pytest.MonkeyPatch) -> None:
    chosen(monkeypatch)
    with pytest.raises(Chosen) as caught:
        ElfRuntime(TINY, providers="cuda")
    assert caught.value.args == (str(TINY),)


MISSING = [name for name in ort.get_all_providers() if name not in ort.get_available_providers()]


def test_where_the_provider_is_missing_the_bundled_file_suits_the_cpu() -> None:
    with pytest.warns(RuntimeWarning, match=MISSING[0]):
        elf = ElfRuntime(providers=MISSING[0], fallback=True)
    assert elf.contract.precision == "int8"


def test_where_the_provider_does_not_start_the_bundled_file_suits_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    installed = ort.get_available_providers()
    real, tried = sessions.open_session, []

    def opened(model: Any, providers: Any, **options: Any) -> Any:
        """As ONNX Runtime does: a provider that does not start leaves a session of the CPU."""
        tried.append(providers)
        return real(model, "cpu", **options)

    monkeypatch.setattr("elf_runtime.model.session.ort.get_available_providers", lambda: [MISSING[0], *installed])
    monkeypatch.setattr(sessions, "open_session", opened)
    elf = ElfRuntime(providers=[MISSING[0], "cpu"], fallback=True)
    assert (elf.contract.precision, elf.providers) == ("int8", ["CPUExecutionProvider"])
    elf.detect(textured(64, 80))
    assert tried == [[MISSING[0], "CPUExecutionProvider"], ["CPUExecutionProvider"], ["CPUExecutionProvider"]]


@pytest.mark.parametrize("fallback", [False, True])
def test_a_provider_that_does_not_start(monkeypatch: pytest.MonkeyPatch, fallback: bool) -> None:
    real = ort.InferenceSession

    def on_cpu(model: Any, options: Any, providers: Any) -> Any:
        """As ONNX Runtime does: it leaves a session of the CPU."""
        return real(model, options, providers=["CPUExecutionProvider"])

    monkeypatch.setattr("elf_runtime.model.session.ort.get_available_providers", ort.get_all_providers)
    monkeypatch.setattr("elf_runtime.model.session.ort.InferenceSession", on_cpu)
    words = "CUDAExecutionProvider is installed but did not start"
    with pytest.warns(RuntimeWarning, match=words) if fallback else pytest.raises(ProviderError, match=words):
        open_session(TINY, "cuda", fallback=fallback)


def test_a_provider_s_options_are_kept() -> None:
    given = ["cpu", ("CPU", {"use_arena": "0"})]
    wanted = ["CPUExecutionProvider", ("CPUExecutionProvider", {"use_arena": "0"})]
    assert resolve_providers(given, fallback=False) == wanted


def test_the_bundled_model_says_which_it_is() -> None:
    contract = ElfRuntime().contract
    assert contract.precision == "int8"
    assert ElfRuntime(bundled_model()).contract.precision == "fp32"


# -- presets -----------------------------------------------------------------------------------------------------


def test_the_presets_are_these() -> None:
    assert PRESETS == (
        "fast", "default", "accurate", "multiscale", "paper", "paper-webcam", "paper-robust", "paper-components"
    )  # fmt: skip
    narrow, wide = (3, 0.8), (5, 1.2)
    common = {"normalize": 0.95, "suppression": "maxima", "subpixel": True}
    assert preset("fast") == DetectionParams(narrow, scale=0.33, nms_radius=5, border=20, min_contrast=1.0, **common)
    assert preset("default") == DetectionParams(wide, scale=0.45, nms_radius=5, border=14, **common)
    assert preset("accurate") == DetectionParams(narrow, scale=1.0, nms_radius=3, border=12, **common)
    assert preset("multiscale") == preset("default").updated(scales=(0.25, 0.5, 1.0), denoise=narrow, nms_radius=3)
    for name in ("fast", "default", "accurate", "multiscale"):
        assert preset(name, "xception") == preset(name)
        for scale in preset(name).working_scales:
            assert f"{scale:g}" in (preset.__doc__ or "")


def test_the_paper_s_table() -> None:
    """(denoise, threshold_blur) of each experiment, by network; all else is the same."""
    vgg, wide = ((5, 5.0), (5, 4.0)), (17, 6.0)
    table = {
        "paper": {
            "vgg": vgg, "xception": ((9, 3.0), (5, 4.0)), "superpoint": ((7, 2.0), wide),
            "sobel": ((9, 9.0), (5, 4.0)), "laplacian": ((9, 9.0), (5, 4.0)),
        },
        "paper-webcam": {"vgg": vgg, "xception": ((9, 9.0), (5, 4.0)), "superpoint": ((7, 2.0), wide)},
        "paper-robust": dict.fromkeys(("vgg", "xception", "superpoint"), ((5, 2.0), wide)),
        "paper-components": {
            "vgg": ((5, 5.0), (5, 5.0)), "xception": ((9, 3.0), (5, 5.0)), "superpoint": ((7, 2.0), (5, 5.0)),
        },
    }  # fmt: skip
    for name, networks in table.items():
        for network, (denoise, threshold_blur) in networks.items():
            wanted = DetectionParams(
                denoise, threshold_blur, "kapur", 10, 10, 500, 1.0, quantize=True, min_contrast=0.0
            )
            assert preset(name, network) == wanted, (name, network)


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
    assert sizes == [(79, 106), (108, 144), (240, 320)]


# -- threads that wait -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("spin", "within", "stops"), [(None, "1", "1"), (False, "0", "1"), (True, "1", "0")])
def test_spin_reaches_the_session(spin: bool | None, within: str, stops: str) -> None:
    session, _ = open_session(TINY, spin=spin)
    options = session.get_session_options()
    assert options.get_session_config_entry("session.intra_op.allow_spinning") == within
    assert options.get_session_config_entry("session.force_spinning_stop") == stops


@pytest.mark.parametrize("threads", [1, 3])
def test_threads_reach_the_session(threads: int) -> None:
    session, _ = open_session(TINY, threads=threads)
    assert session.get_session_options().intra_op_num_threads == threads


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
