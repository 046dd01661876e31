"""Agreement of two ways to run a model: the measure itself, and elf-info's use of it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import onnxruntime as ort
import pytest

from elf_runtime import ElfRuntime, Features, SettingError
from elf_runtime.checks.agreement import agreement, compare, pattern
from elf_runtime.commands.info import main
from elf_runtime.model import bundled_model, sessions
from elf_runtime.model.providers import is_cpu
from helpers import TINY

AZURE = "AzureExecutionProvider"  # installed with the CPU build, runs no op of ONNX's own, leaves all to the CPU
needs_azure = pytest.mark.skipif(AZURE not in ort.get_available_providers(), reason=f"no {AZURE} in this build")


def features(points: Sequence[tuple[float, float]], descriptors: Any = None) -> Features:
    keypoints = np.array(points, np.float32).reshape(-1, 2)
    given = np.zeros((len(keypoints), 0)) if descriptors is None else descriptors
    return Features(keypoints, np.ones(len(keypoints), np.float32), np.asarray(given, np.float32), (100, 100))


def test_shares_are_of_the_larger_number() -> None:
    a = features([(10, 10), (30, 30), (50, 50)])
    b = features([(10.4, 10), (30.6, 30.6), (50, 52), (80, 80)])
    found = agreement(a, b)
    assert (found.reference, found.found) == (3, 4)
    assert (found.same, found.near) == (0.25, 0.5)
    assert (agreement(b, a).same, agreement(b, a).near) == (0.25, 0.5)
    assert not found.sufficient
    assert found.cosine is None


def test_one_keypoint_is_not_counted_for_two() -> None:
    assert agreement(features([(10, 10), (10.3, 10)]), features([(10.1, 10)])).near == 0.5


def test_nine_in_ten_are_sufficient() -> None:
    points = [(10.0 * i, 5.0) for i in range(10)]
    assert agreement(features(points), features(points[:9])).sufficient
    assert not agreement(features(points), features(points[:8])).sufficient


def test_descriptors_of_near_keypoints_are_compared_pairwise() -> None:
    a = features([(10, 10), (30, 30), (90, 90)], [[1, 0], [0, 1], [1, 0]])
    b = features([(30, 30), (10, 10), (50, 50)], [[0.6, 0.8], [1, 0], [0, 1]])
    found = agreement(a, b)
    assert found.least_cosine == pytest.approx(0.8)
    assert found.cosine == pytest.approx(0.9)


def test_nothing_found() -> None:
    none, one = features([]), features([(1, 1)])
    assert agreement(none, none).near == 1.0
    assert agreement(one, none).near == 0.0
    assert agreement(none, one).near == 0.0


def test_features_of_different_images_are_refused() -> None:
    with pytest.raises(SettingError, match="features of images of"):
        agreement(Features(*[np.zeros((0, 2), np.float32)] * 3, (5, 5)), features([]))


def test_a_model_agrees_with_itself() -> None:
    found = compare(ElfRuntime(TINY), ElfRuntime(TINY, threads=2), pattern())
    assert found.found == found.reference > 50
    assert found.same == 1.0
    assert found.least_cosine == pytest.approx(1.0)


class Shifted:
    """A session whose maps are wrong: moved by some rows."""

    def __init__(self, session: ort.InferenceSession, rows: int) -> None:
        self.session, self.rows = session, rows

    def __getattr__(self, name: str) -> Any:
        return getattr(self.session, name)

    def run(self, names: Sequence[str], feeds: dict[str, Any], options: Any) -> list[Any]:
        return [np.roll(value, self.rows, axis=1) for value in self.session.run(names, feeds)]


def shift(monkeypatch: pytest.MonkeyPatch, rows: int) -> None:
    """Let every session but the CPU's give shifted maps."""
    real = sessions.open_session

    def opened(model: Any, providers: Any = None, **options: Any) -> tuple[Any, str]:
        session, name = real(model, providers=providers, **options)
        return (session if is_cpu(providers) else Shifted(session, rows)), name

    monkeypatch.setattr(sessions, "open_session", opened)


@needs_azure
def test_elf_info_reports_the_agreement(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(TINY)]) == 0
    text = capsys.readouterr().out
    assert "100.0% the same within 0.5 px, 100.0% within 1 px" in text
    assert main([str(TINY), "--json"]) == 0
    providers = json.loads(capsys.readouterr().out)["providers"]
    assert providers["CPUExecutionProvider"]["agreement"] is None
    found = providers[AZURE]["agreement"]
    assert found["reference"] == found["found"] > 50
    assert found["same"] == found["near"] == 1.0
    assert found["sufficient"] is True


@needs_azure
def test_elf_info_fails_on_a_provider_that_computes_wrongly(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shift(monkeypatch, 3)
    assert main([str(TINY), "--provider", AZURE]) == 1
    captured = capsys.readouterr()
    assert "DIFFERS: " in captured.out
    assert f"{AZURE} finds other keypoints in {TINY} than the CPU: " in captured.err
    assert captured.err.count("\n") == 1


@needs_azure
def test_elf_info_compares_on_the_given_image(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import cv2

    cv2.imwrite(str(tmp_path / "a.png"), pattern(64, 80))
    assert main([str(TINY), "--provider", AZURE, "--json", "--image", str(tmp_path / "a.png")]) == 0
    found = json.loads(capsys.readouterr().out)["providers"][AZURE]["agreement"]
    assert found["reference"] == len(ElfRuntime(TINY).detect(pattern(64, 80)))


def test_options_reach_the_provider(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(TINY), "--provider", "cpu", "--option", "use_arena=0"]) == 0
    assert main([str(TINY), "--option", "use_arena=0"]) == 2
    assert "--provider-option is for the provider that --provider names" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([str(TINY), "--provider", "cpu", "--option", "fast"])
    assert "'fast' is not KEY=VALUE" in capsys.readouterr().err


def test_the_pattern_is_always_the_same() -> None:
    picture = pattern()
    assert picture.shape == (240, 320, 3)
    assert picture.dtype == np.uint8
    np.testing.assert_array_equal(picture, pattern())
    assert (picture.min(), picture.max()) == (0, 255)


@pytest.mark.skipif(
    "OpenVINOExecutionProvider" not in ort.get_available_providers(),
    reason="onnxruntime-openvino is not installed",
)
def test_openvino_finds_the_cpus_keypoints() -> None:
    model = bundled_model("fp32")  # for the CPU alone the default is the int8 file
    found = compare(ElfRuntime(model), ElfRuntime(model, providers="openvino"), pattern())
    assert found.reference > 100
    assert found.same >= 0.99
    assert found.least_cosine == pytest.approx(1.0, abs=1e-3)
