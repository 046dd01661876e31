"""Each step of the end-to-end graph against the runtime's numpy, or a plain loop."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("onnx")

from elf_export.end_to_end import levels, places, refine, suppress
from elf_export.end_to_end.describe import described
from elf_export.end_to_end.resize import Working, working_image
from elf_runtime import DescriptorSpec, DetectionParams, InputSpec
from elf_runtime.detection.contrast import contrast_map
from elf_runtime.detection.descriptors import sample
from elf_runtime.detection.refine import quadratic_peaks
from elf_runtime.detection.rounding import rounded
from elf_runtime.detection.threshold import blurred, lowest_passing
from elf_runtime.image.convert import resized, to_pixels
from elf_runtime.image.masks import shrunk
from helpers import textured

from .running import run

pytestmark = pytest.mark.torch


@pytest.mark.parametrize("scale", [0.2, 0.33, 0.45, 0.5, 1.0, 1.5, 2.0])
@pytest.mark.parametrize("size", [(64, 96), (97, 131), (40, 333), (33, 34)])
@pytest.mark.parametrize("multiple", [1, 8])
def test_the_working_image_is_the_runtime_s(scale: float, size: tuple[int, int], multiple: int) -> None:
    image, spec = textured(*size), InputSpec(min_size=32, multiple=multiple)
    pixels, h, w = run(
        lambda e, x: ((seen := working_image(e, x, spec, scale)).pixels, *seen.working), {"image": image[None]}
    )
    actual = max(scale, spec.min_size / min(size)) if scale < 1 else scale
    assert (h, w) == spec.size_for(*size, actual)
    wanted = resized(image.astype(np.float32), (int(h), int(w)))
    if h <= size[0] and w <= size[1]:
        np.testing.assert_array_equal(pixels[0], wanted)
    else:
        # One side larger and one smaller, as multiples may have it: OpenCV has a way of its own for that.
        np.testing.assert_allclose(pixels[0], wanted, atol=1e-3 if scale > 1 else 0.2)


def test_several_images_are_resized_each_by_itself() -> None:
    images = np.stack([textured(60, 80, seed) for seed in range(3)])
    (together,) = run(lambda e, x: working_image(e, x, InputSpec(), 0.7).pixels, {"image": images})
    for image, pixels in zip(images, together, strict=True):
        np.testing.assert_array_equal(pixels, resized(image.astype(np.float32), pixels.shape[:2]))


@pytest.mark.parametrize("color", ["bgr", "rgb", "gray"])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("given", ["bgr", "rgb"])
def test_grey_and_colour(color: str, channels: int, given: str) -> None:
    image = textured(40, 50, channels=channels)
    spec = InputSpec(color=color, channels=1 if color == "gray" else 3)
    fed = image if given == "bgr" else image[:, :, ::-1]
    (pixels,) = run(lambda e, x: working_image(e, x, spec, 1.0, given).pixels, {"image": fed[None]})
    np.testing.assert_allclose(pixels[0], to_pixels(image, spec), atol=1e-4)


def saliency(kind: str, shape: tuple[int, int] = (45, 61)) -> np.ndarray:
    rng = np.random.default_rng(3)
    maps = {
        "smooth": rng.gamma(0.7, 1.0, shape),
        "zero": np.zeros(shape),
        "mostly zero": rng.gamma(0.7, 1.0, shape) * (rng.random(shape) < 0.02),
        "two values": np.where(rng.random(shape) < 0.3, 5.0, 1.0),
        "one value": np.full(shape, 2.0),
        "large": rng.gamma(0.7, 1e20, shape),
    }
    return maps[kind].astype(np.float32)


@pytest.mark.parametrize("kind", ["smooth", "zero", "mostly zero", "two values", "one value", "large"])
@pytest.mark.parametrize(
    "settings",
    [{}, {"normalize": 0.95, "denoise": (3, 0.8)}, {"quantize": True}, {"denoise": (1, 1.0), "normalize": 0.5}],
)
@pytest.mark.parametrize("masked", [False, True])
def test_scores_and_kapur_s_level(kind: str, settings: dict[str, object], masked: bool) -> None:
    params, found = DetectionParams().updated(**settings), saliency(kind)
    allowed = np.ones(found.shape, np.bool_)
    if masked:
        allowed[:20] = False
    scores, level = run(
        lambda e, s, a, t: levels.scores_and_level(e, s, params, a, t),
        {"saliency": found[None], "allowed": allowed, "threshold": np.float32(-1)},
    )
    given = allowed if masked else None
    wanted, smooth = blurred(found, params, given)
    np.testing.assert_allclose(scores[0, 0], wanted, rtol=1e-5, atol=0 if params.quantize else 1e-4)
    assert level == lowest_passing(wanted, smooth, params, given)[0]


def test_a_level_that_is_given() -> None:
    inputs = {"saliency": saliency("smooth")[None], "allowed": np.ones((45, 61), np.bool_), "t": np.float32(0.25)}
    _, level = run(lambda e, s, a, t: levels.scores_and_level(e, s, DetectionParams(), a, t), inputs)
    assert level == np.float32(255 * 0.25)


@pytest.mark.parametrize("pixels", [0, 1, 3, 500])
@pytest.mark.parametrize("shape", [(40, 53), (1, 1)])
@pytest.mark.parametrize("kind", [np.uint8, np.bool_, np.int64])
def test_masks_shrink_as_the_runtime_s(pixels: int, shape: tuple[int, int], kind: type) -> None:
    mask = np.ones(shape, kind)
    if shape != (1, 1):
        mask[10:13, 20:30] = mask[30:, :5] = 0
    (found,) = run(places.shrunk, {"mask": mask, "pixels": np.int64(pixels)})
    np.testing.assert_array_equal(found, shrunk(mask != 0, pixels))


@pytest.mark.parametrize("border", [0, 1, 7, 19, 60])
def test_the_border_is_the_runtime_s(border: int) -> None:
    from elf_runtime.detection.scaling import Scaling

    source, working = (81, 120), (36, 54)
    sizes = {name: np.int64(n) for name, n in zip("HWhw", (*source, *working), strict=True)}
    (inside,) = run(lambda e, H, W, h, w: places.within_border(e, border, Working("", (H, W), (h, w), "")), sizes)
    rows, columns = Scaling(source, working, 0.45).margin(border)
    wanted = np.zeros(working, np.bool_)
    wanted[rows : working[0] - rows, columns : working[1] - columns] = True
    np.testing.assert_array_equal(inside, wanted)


@pytest.mark.parametrize("side", [11, 13, 25])
@pytest.mark.parametrize("channels", [1, 3])
def test_contrast(side: int, channels: int) -> None:
    ramp = np.linspace(0, 60, 70)[None, :, None] + np.zeros((50, 70, channels))
    image = (ramp + textured(50, 70, channels=channels).reshape(50, 70, channels) * (ramp > 30)).astype(np.float32)
    wanted = contrast_map(image, side)
    least = float(np.quantile(wanted, 0.4))
    (enough,) = run(lambda e, x: places.enough_contrast(e, x, channels, side, least), {"x": image[None]})
    clear = np.abs(wanted - least) > 1e-2
    assert clear.mean() > 0.9
    np.testing.assert_array_equal(enough[clear], (wanted >= least)[clear])


def plain_greedy(scores: np.ndarray, candidates: np.ndarray, radius: int) -> np.ndarray:
    """One candidate after the other, by descending score, ties in raster order."""
    left, taken = candidates.copy(), np.zeros(scores.shape, np.bool_)
    for flat in np.argsort(-scores.ravel(), kind="stable"):
        y, x = divmod(int(flat), scores.shape[1])
        if left[y, x]:
            taken[y, x] = True
            left[max(0, y - radius) : y + radius + 1, max(0, x - radius) : x + radius + 1] = False
    return taken


@pytest.mark.parametrize("radius", [0, 1, 2, 5])
@pytest.mark.parametrize("levels_of", [0, 2, 4, 1000])
def test_suppression_is_the_plain_loop_s_on_plateaus_too(radius: int, levels_of: int) -> None:
    rng = np.random.default_rng(radius + 10 * levels_of)
    scores = rng.integers(0, levels_of + 1, (31, 44)).astype(np.float32)
    candidates = (rng.random(scores.shape) < 0.7) & (scores > 0)
    window = suppress.Window(radius, radius)
    (taken,) = run(
        lambda e, s, c: suppress.greedy(e, s, c, window, 0), {"s": scores[None, None], "c": candidates[None, None]}
    )
    np.testing.assert_array_equal(taken[0, 0] > 0, plain_greedy(scores, candidates, radius))


def test_a_window_that_grows_for_small_images() -> None:
    scores = np.random.default_rng(0).random((30, 40)).astype(np.float32)
    for seen, radius in ((0.45, 2), (0.6, 3), (0.75, 4), (1.0, 5)):
        taken, maxima = run(
            lambda e, s, c, at: (
                suppress.greedy(e, s, c, suppress.Window.of(e, 5, 0.45, at, False), 0),
                suppress.window_maxima(e, s, suppress.Window.of(e, 5, 0.45, at, False)),
            ),
            {"s": scores[None, None], "c": np.ones((1, 1, 30, 40), np.bool_), "at": np.float64(seen)},
        )
        np.testing.assert_array_equal(taken[0, 0] > 0, plain_greedy(scores, np.ones((30, 40), np.bool_), radius))
        padded = np.pad(scores, radius, constant_values=-1)
        around = np.lib.stride_tricks.sliding_window_view(padded, (2 * radius + 1,) * 2)
        np.testing.assert_array_equal(maxima[0, 0], scores >= around.max(axis=(2, 3)))


@pytest.mark.parametrize("most", [0, 1, 5, 10_000])
def test_the_strongest_come_first_ties_in_raster_order(most: int) -> None:
    rng = np.random.default_rng(1)
    scores = rng.integers(1, 4, (20, 30)).astype(np.float32)
    taken = (rng.random((20, 30)) < 0.2).astype(np.float32)
    inputs = {"s": scores[None, None], "t": taken[None, None], "most": np.int64(most)}
    values, flat, count = run(lambda e, s, t, most: suppress.strongest(e, s, s, t, most), inputs)
    wanted = [i for i in np.argsort(-scores.ravel(), kind="stable") if taken.ravel()[i]][:most]
    assert (len(flat), count) == (max(len(wanted), 1), len(wanted))
    assert flat[:count].tolist() == wanted
    np.testing.assert_array_equal(values[:count], scores.ravel()[wanted])


def test_ranks_say_which_are_kept_and_scores_in_which_order() -> None:
    ranks = np.array([[1, 2, 2, 2, 3]], np.float32)
    scores = np.array([[1.1, 2.1, 1.9, 2.2, 2.9]], np.float32)
    inputs = {"s": scores[None, None], "r": ranks[None, None], "t": np.ones((1, 1, 1, 5), np.float32), "m": np.int64(3)}
    values, flat, count = run(suppress.strongest, inputs)
    assert (flat.tolist(), count) == ([4, 1, 2], 3)
    np.testing.assert_array_equal(values, scores[0, [4, 1, 2]])


def test_scores_are_rounded_as_the_runtime_s() -> None:
    rng = np.random.default_rng(4)
    scores = (rng.random(100_000) * 2.0 ** rng.integers(-30, 30, 100_000)).astype(np.float32)
    (found,) = run(levels.rounded, {"s": scores})
    np.testing.assert_array_equal(found, rounded(scores))
    assert len(np.unique(found)) < len(np.unique(scores))


def test_sub_pixel_places() -> None:
    rng = np.random.default_rng(2)
    scores = rng.integers(0, 5, (23, 31)).astype(np.float32)  # plateaus, ties and saddles among them
    scores[10:] += rng.random((13, 31)).astype(np.float32)
    scores[:5] *= (1 + 1e-6 * rng.standard_normal((5, 31))).astype(np.float32)
    y, x = np.divmod(np.arange(scores.size), 31)
    inputs = {"s": scores[None, None], "x": x, "y": y, "h": np.int64(23), "w": np.int64(31)}
    found = run(lambda e, s, x, y, h, w: refine.quadratic_peaks(e, s, x, y, (h, w)), inputs)
    np.testing.assert_allclose(np.stack(found, axis=1), quadratic_peaks(scores, np.stack([x, y], axis=1)), atol=1e-5)


@pytest.mark.parametrize("shape", [(9, 13), (1, 1), (1, 7), (2, 2)])
def test_descriptors_are_interpolated_as_the_runtime_does(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(5)
    values = rng.standard_normal((*shape, 6)).astype(np.float32)
    points = rng.uniform(-10, 70, (200, 2)).astype(np.float32)
    spec = DescriptorSpec("d", "d", 6, 16 / 3, 2.1)
    inputs = {"d": values[None], "x": points[:, 0].astype(np.float64), "y": points[:, 1].astype(np.float64)}
    (found,) = run(lambda e, d, x, y: described(e, d, spec, x, y), inputs)
    np.testing.assert_allclose(found, sample(values, points, spec.stride, spec.offset), atol=1e-6)
