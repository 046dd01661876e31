"""Methods by their texts, detectors with other descriptors, and plugins."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import pytest
from scenes import SIZE, check

from elf_eval.errors import EvalError
from elf_eval.methods import open_method, open_methods
from elf_eval.methods.method import Method
from elf_eval.methods.opencv import installed


def test_describing_others_keypoints_keeps_their_rows(image):
    detected = open_method("gftt").extract(image, 60)
    described = open_methods("gftt", "sift").extract(image, 60)
    assert described.descriptors.shape == (len(described), 128)
    rows = {tuple(p) for p in detected.keypoints.tolist()}
    assert {tuple(p) for p in described.keypoints.tolist()} <= rows
    check(described)


def test_a_detector_cannot_describe_and_the_other_way_round(image):
    with pytest.raises(EvalError, match="mser can't describe"):
        open_methods("sift", "mser").extract(image, 10)
    with pytest.raises(EvalError, match="no descriptor of its own"):
        open_methods("sift", "sobel").extract(image, 10)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("surfboard", "unknown method"),
        ("elf:nowhere.onnx", "no such file: nowhere.onnx"),
        ("xfeat", "none given"),
        ("cv2-aliked:nowhere.onnx", "no such file" if installed("cv2-aliked") else "has no ALIKED"),
        ("aliked:nowhere.onnx", "takes no file; OpenCV's is cv2-aliked:FILE.onnx"),
        ("sift?ratio=1", r"sift\?ratio=1: ratio is a number in \(0, 1\), not 1.0"),
        ("plugin:corners.Corners?ratio=much", "option ratio=much"),
        ("sift?refine=maybe", r"sift\?refine=maybe: option refine=maybe: expected true or false"),
        ("plugin:corners.Corners?refine=1", "option refine=1"),
        ("sobel?preset=none", "unknown preset"),
        ("sobel?denoise=4,2", "denoise"),
        ("sobel?denoise=four", "denoise=four"),
        ("sobel?scale=0.5", "not at scale"),
        ("plugin:nowhere.make", "can't import"),
        ("sift?fast", "not name=value"),
        ("sift?refine=true&ratio=0.8&refine=false", "option refine is given twice"),
    ],
)
def test_a_wrong_text_is_named(text, words):
    with pytest.raises(EvalError, match=words):
        open_method(text)


def test_a_plugin_takes_its_options(image):
    method = open_method("plugin:corners.Corners?inset=4")
    assert method.extract(image, 2).keypoints.tolist() == [[4, 4], [SIZE[0] - 5, 4]]
    with pytest.raises(EvalError, match="unknown options"):
        open_method("plugin:corners.Corners?outset=4")


def failing(spec, threads):
    raise RuntimeError("no network\nmore")


def nothing(spec, threads):
    return None


class Nameless(Method):
    def __init__(self, spec, threads):
        pass


@pytest.mark.parametrize(
    ("factory", "reason"),
    [
        (failing, "made_by_tests.factory failed: RuntimeError: no network"),
        (nothing, "made_by_tests.factory returned no Method but NoneType"),
        (Nameless, "the method has no fingerprint, a text that names what its features depend on"),
    ],
)
def test_a_plugin_that_fails_is_named(factory, reason, monkeypatch):
    monkeypatch.setitem(sys.modules, "made_by_tests", SimpleNamespace(factory=factory))
    with pytest.raises(EvalError) as failed:
        open_method("plugin:made_by_tests.factory")
    assert str(failed.value) == f"plugin:made_by_tests.factory: {reason}"


def test_a_wrong_option_is_said_once():
    with pytest.raises(EvalError) as failed:
        open_method("sobel?denoise=4,2")
    assert str(failed.value) == (
        "sobel?denoise=4,2: denoise is (mu, sigma) with mu odd, 1 to 999, and sigma > 0, not 4,2"
    )
