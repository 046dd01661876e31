"""Image gradients as saliency."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scenes import SIZE, check

from elf_eval.errors import EvalError
from elf_eval.methods import open_method
from elf_eval.methods.gradient import gradient_saliency


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
    assert gradient_saliency(ramp, "laplacian")[:, 6:-6] == pytest.approx(0.0)


@pytest.mark.parametrize("kernel", [3, 5, 11])
def test_the_laplacian_of_a_paraboloid_is_its_curvature(kernel):
    """x^2 + 2 y^2 has 2 + 4; a kernel of size K weighs it with the sum of its two binomials, 4^(K - 2)."""
    y, x = np.mgrid[-15:16, -15:16].astype(np.float32)
    inner = slice(kernel // 2, -(kernel // 2))
    found = gradient_saliency(x * x + 2 * y * y, "laplacian", kernel)[inner, inner]
    assert found / 4.0 ** (kernel - 2) == pytest.approx(6.0, rel=1e-4)


def test_a_laplacian_of_5x5_is_the_saliency_of_a_sobel_filter(rng):
    """S = |F^T dF/dI| of F = (gx, gy): each filter's adjoint is the filter turned by half a turn."""
    grey = rng.uniform(0, 255, (30, 40))
    back = 0.0
    for kernel in (np.outer([1, 2, 1], [-1, 0, 1]), np.outer([-1, 0, 1], [1, 2, 1])):
        seen = cv2.filter2D(grey, cv2.CV_64F, kernel.astype(float))
        back = back + cv2.filter2D(seen, cv2.CV_64F, kernel[::-1, ::-1].astype(float))
    found = gradient_saliency(grey.astype(np.float32), "laplacian", 5)
    inner = slice(4, -4)
    assert found[inner, inner] == pytest.approx(np.abs(back)[inner, inner], rel=1e-4, abs=0.05)


@pytest.mark.parametrize("kernel", ["0", "4", "33", "three"])
def test_a_kernel_that_opencv_does_not_have_is_named(kernel):
    with pytest.raises(EvalError, match=f"kernel={kernel}"):
        open_method(f"laplacian?kernel={kernel}")


def test_the_kernel_is_part_of_the_features_identity():
    texts = ("laplacian", "laplacian?kernel=3", "sobel", "sobel?kernel=11")
    assert len({open_method(text).fingerprint for text in texts}) == 4
    assert open_method("laplacian?kernel=13").fingerprint == open_method("laplacian").fingerprint


def test_gradient_saliency_sees_edges_of_both_directions():
    ramp = np.arange(12, dtype=np.float32)[None].repeat(12, 0)
    assert gradient_saliency(ramp.T.copy(), "sobel")[1:-1, 1:-1] == pytest.approx(8.0)
    assert gradient_saliency(3 * ramp + 4 * ramp.T, "sobel")[1:-1, 1:-1] == pytest.approx(40.0)


def test_gradients_without_a_border(image):
    assert len(open_method("sobel?border=0").extract(image, 50)) > 0


@pytest.mark.parametrize("kind", ["sobel", "laplacian"])
def test_gradients_have_the_paper_s_blur_for_them(kind):
    assert '"denoise": [9, 9.0]' in open_method(kind).fingerprint
