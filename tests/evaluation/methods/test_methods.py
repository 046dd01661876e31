"""Methods: what each gives, how detector and descriptor are combined, and what they say when they can't."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scenes import SIZE

from elf_eval.data.images import ImageRef
from elf_eval.errors import EvalError
from elf_eval.features import LocalFeatures
from elf_eval.methods import open_method, open_methods
from elf_eval.methods.gradient import gradient_saliency
from elf_eval.methods.opencv import OPENCV, installed
from elf_eval.methods.xfeat import keypoint_probability, local_maxima, sample_cells


@pytest.fixture
def image(photo_file):
    return ImageRef("scene/photo.png", photo_file).open(None)


def check(found, size=SIZE):
    """What every method promises."""
    assert (np.diff(found.scores) <= 0).all()
    assert found.keypoints.dtype == np.float32
    assert (found.keypoints >= -0.5).all()
    assert (found.keypoints < np.array(size)).all()
    assert len(found.descriptors) == len(found)


@pytest.mark.parametrize("kind", [k for k in OPENCV if k not in ("aliked", "disk")])
def test_opencv(kind, image):
    if not installed(kind):
        with pytest.raises(EvalError, match=f"{kind}: this OpenCV build .* has no"):
            open_method(kind)
        return
    found = open_method(kind).extract(image, 30)
    check(found)
    assert len(found) <= 30
    # MSER finds nothing stable in a picture of flat shapes.
    assert len(found) > 0 or kind == "mser"


def test_opencv_takes_its_own_arguments_and_refuses_others(image):
    few = open_method("sift?contrastThreshold=0.15").extract(image, 500)
    assert len(few) < len(open_method("sift").extract(image, 500))
    with pytest.raises(EvalError, match="nonsense"):
        open_method("sift?nonsense=3")


@pytest.mark.parametrize("kind", ["sift", "orb"])
def test_a_flat_image_has_no_keypoints_but_descriptors_of_the_right_kind(kind, tmp_path):
    cv2.imwrite(str(tmp_path / "flat.png"), np.full((100, 100, 3), 90, np.uint8))
    flat = ImageRef("flat", tmp_path / "flat.png").open(None)
    found = open_method(kind).extract(flat, 10)
    assert len(found) == 0
    assert found.descriptors.shape[1] > 0
    assert (found.descriptors.dtype == np.uint8) == (kind == "orb")


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


@pytest.mark.parametrize("kind", ["sobel", "laplacian"])
def test_gradients_keep_border_and_distance(kind, image):
    found = open_method(f"{kind}?nms_radius=8&border=12").extract(image, 500)
    check(found)
    assert len(found) > 3
    assert (found.keypoints >= 12).all()
    assert (found.keypoints < np.array(SIZE) - 12).all()
    gap = np.abs(found.keypoints[:, None] - found.keypoints[None]).max(axis=2)
    assert gap[~np.eye(len(found), dtype=bool)].min() > 8


def test_gradient_saliency_of_a_ramp():
    ramp = np.tile(np.arange(20, dtype=np.float32), (10, 1))
    assert gradient_saliency(ramp, "sobel")[2:-2, 2:-2] == pytest.approx(8.0)
    assert gradient_saliency(ramp, "laplacian")[:, 5:-5] == pytest.approx(0.0)


@pytest.mark.parametrize("kernel", [3, 5, 11])
def test_the_laplacian_of_a_paraboloid_is_its_curvature(kernel):
    """x^2 + 2 y^2 has 2 + 4; a kernel of size K weighs it with the sum of its two binomials, 4^(K - 2)."""
    y, x = np.mgrid[-15:16, -15:16].astype(np.float32)
    inner = slice(kernel // 2, -(kernel // 2))
    found = gradient_saliency(x * x + 2 * y * y, "laplacian", kernel)[inner, inner]
    assert found / 4.0 ** (kernel - 2) == pytest.approx(6.0, rel=1e-4)


@pytest.mark.parametrize("kernel", ["0", "4", "33", "three"])
def test_a_kernel_that_opencv_does_not_have_is_named(kernel):
    with pytest.raises(EvalError, match=f"kernel={kernel}"):
        open_method(f"laplacian?kernel={kernel}")


def test_the_kernel_is_part_of_the_features_identity():
    texts = ("laplacian", "laplacian?kernel=3", "sobel", "sobel?kernel=11")
    assert len({open_method(text).fingerprint for text in texts}) == 4
    assert open_method("laplacian?kernel=11").fingerprint == open_method("laplacian").fingerprint


def test_gradient_saliency_sees_edges_of_both_directions():
    ramp = np.arange(12, dtype=np.float32)[None].repeat(12, 0)
    assert gradient_saliency(ramp.T.copy(), "sobel")[1:-1, 1:-1] == pytest.approx(8.0)
    assert gradient_saliency(3 * ramp + 4 * ramp.T, "sobel")[1:-1, 1:-1] == pytest.approx(40.0)


def test_gradients_without_a_border(image):
    assert len(open_method("sobel?border=0").extract(image, 50)) > 0


@pytest.mark.parametrize("kind", ["sobel", "laplacian"])
def test_gradients_have_the_paper_s_blur_for_them(kind):
    assert '"denoise": [9, 9.0]' in open_method(kind).fingerprint


def write_npz(folder, name, points, **more):
    path = folder / f"{name}.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, keypoints=np.asarray(points, np.float32), **more)


def test_precomputed_npz_in_d2_nets_style(image, tmp_path):
    points = [[10, 20, 1.0], [30, 40, 1.0], [50, 60, 2.0]]
    scores, descriptors = np.float32([0.1, 0.9, 0.5]), np.eye(3, 8, dtype=np.float32)
    write_npz(tmp_path, image.name, points, scores=scores, descriptors=descriptors)
    found = open_method(f"npz:{tmp_path}").extract(image, 2)
    assert found.keypoints.tolist() == [[30, 40], [50, 60]]
    assert found.descriptors.tolist() == descriptors[[1, 2]].tolist()


def test_precomputed_without_scores_are_strongest_first(image, tmp_path):
    write_npz(tmp_path, image.name, [[1, 2], [3, 4], [5, 6]])
    assert open_method(f"npz:{tmp_path}").extract(image, 2).keypoints.tolist() == [[1, 2], [3, 4]]


def test_precomputed_keypoints_follow_the_resized_image(photo_file, tmp_path):
    half = ImageRef("photo.png", photo_file).open((100, 80))
    write_npz(tmp_path, "photo.png", [[11.5, 21.5]])
    assert open_method(f"npz:{tmp_path}").extract(half, 5).keypoints.tolist() == [[5.5, 10.5]]
    assert open_method(f"npz:{tmp_path}?frame=working").extract(half, 5).keypoints.tolist() == [[11.5, 21.5]]


def test_precomputed_h5_in_hlocs_style(image, tmp_path):
    h5py = pytest.importorskip("h5py")
    descriptors = np.arange(6, dtype=np.float32).reshape(3, 2)  # (D, N)
    with h5py.File(tmp_path / "f.h5", "w") as file:
        group = file.create_group(image.name)
        group["keypoints"], group["scores"] = np.float32([[1, 2], [3, 4]]), np.float32([0.2, 0.1])
        group["descriptors"] = descriptors
    found = open_method(f"h5:{tmp_path / 'f.h5'}").extract(image, 5)
    assert found.keypoints.tolist() == [[1, 2], [3, 4]]
    assert found.descriptors.tolist() == descriptors.T.tolist()


def test_an_edited_feature_file_is_read_again_under_any_descriptor(image, tmp_path):
    write_npz(tmp_path, image.name, [[20, 20]])
    assert not open_method(f"npz:{tmp_path}").cacheable
    assert not open_methods(f"npz:{tmp_path}", "orb").cacheable
    assert open_methods("gftt", "orb").cacheable


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, r"photo\.png\.npz: no features"),
        ({"points": [[1, 2]]}, "no keypoints in it"),
        ({"keypoints": [[1.0, 2.0]], "descriptors": np.zeros((2, 4), np.float32)}, r"expected \(1, D\)"),
        ({"keypoints": [[1.0, np.nan]]}, "NaN"),
    ],
)
def test_precomputed_damage_is_named(image, tmp_path, content, words):
    if content is not None:
        path = tmp_path / f"{image.name}.npz"
        path.parent.mkdir(parents=True)
        np.savez(path, **content)
    with pytest.raises(EvalError, match=words):
        open_method(f"npz:{tmp_path}").extract(image, 5)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("surfboard", "unknown method"),
        ("elf:nowhere.onnx", "no such file: nowhere.onnx"),
        ("xfeat", "none given"),
        ("aliked:nowhere.onnx", "no such file" if installed("aliked") else "has no ALIKED"),
        ("sobel?preset=none", "unknown preset"),
        ("sobel?denoise=4,2", "denoise"),
        ("sobel?denoise=four", "denoise=four"),
        ("sobel?scale=0.5", "not at scale"),
        ("plugin:nowhere.make", "can't import"),
        ("sift?fast", "not name=value"),
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


def test_xfeat_puts_a_cells_channels_in_raster_order():
    logits = np.full((65, 2, 3), -20.0, np.float32)
    logits[8 * 5 + 2, 1, 2] = 20.0  # row 5, column 2 of the cell in row 1, column 2
    logits[64, 0, 0] = 20.0  # no keypoint here
    heat = keypoint_probability(logits)
    assert heat.shape == (16, 24)
    assert np.unravel_index(heat.argmax(), heat.shape) == (8 + 5, 16 + 2)
    assert heat.max() == pytest.approx(1.0)
    assert heat[:8, :8].max() < 1e-6
    assert local_maxima(heat, 2)[13, 18]


@pytest.mark.parametrize("cubic", [False, True])
def test_xfeat_samples_a_plane_exactly_between_cell_centres(cubic):
    y, x = np.mgrid[0:8, 0:9].astype(np.float32)
    maps = np.stack([2 * x + 3 * y, x - y])
    points = np.array([[27.5, 35.5], [30.0, 41.3]])
    cells = (points + 0.5) / 8 - 0.5
    expected = np.stack([2 * cells[:, 0] + 3 * cells[:, 1], cells[:, 0] - cells[:, 1]], axis=1)
    # Keys' kernel with a = -0.75 gives back planes at cell centres alone, and nearly so elsewhere.
    assert sample_cells(maps, points, cubic) == pytest.approx(expected, abs=0.2 if cubic else 1e-4)
    centres = np.array([[27.5, 35.5]])
    assert sample_cells(maps, centres, cubic) == pytest.approx(expected[:1], abs=1e-5)


def test_features_are_sorted_with_ties_in_their_order():
    found = LocalFeatures.build([[0, 0], [1, 1], [2, 2]], [1, 2, 2])
    assert found.keypoints.tolist() == [[1, 1], [2, 2], [0, 0]]
    points = np.arange(200.0).reshape(100, 2)
    found = LocalFeatures.build(points, np.arange(100) % 2)
    np.testing.assert_array_equal(found.keypoints, np.concatenate([points[1::2], points[::2]]))


def test_xfeat_on_a_photograph(shared):
    weights = shared / "peers" / "xfeat.onnx"
    if not weights.is_file():
        pytest.skip("no shared/peers/xfeat.onnx")
    pixels = ImageRef("1", shared / "data/oxford_affine/v_graf/1.png").open((640, 480))
    method = open_method(f"xfeat:{weights}", threads=1)
    found = method.extract(pixels, 200)
    check(found, (640, 480))
    assert len(found) == 200
    again = method.describe(pixels, found)
    assert np.linalg.norm(again.descriptors, axis=1) == pytest.approx(1.0, abs=1e-5)
    assert (again.descriptors * found.descriptors).sum(axis=1).min() > 0.9999
