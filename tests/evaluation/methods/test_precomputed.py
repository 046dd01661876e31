"""Features that another program wrote."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from elf_eval.data.images import ImageRef
from elf_eval.errors import EvalError
from elf_eval.methods import open_method, open_methods
from elf_runtime import Features


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


def test_features_of_the_images_that_elf_eval_images_writes_are_found(photo_file, tmp_path):
    """As .png, also where the publishers have .ppm or .jpg; features by the dataset's own name go before."""
    ref = ImageRef("v_turn/1@scale-1.25.ppm", photo_file)
    write_npz(tmp_path / "npz", "v_turn/1@scale-1.25.png", [[1, 2]])
    method = open_method(f"npz:{tmp_path / 'npz'}")
    method.check([ref])
    assert method.extract(ref.open(None), 2).keypoints.tolist() == [[1, 2]]
    write_npz(tmp_path / "npz", ref.name, [[3, 4]])
    assert method.extract(ref.open(None), 2).keypoints.tolist() == [[3, 4]]
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file["v_turn/1@scale-1.25.png/keypoints"] = np.float32([[5, 6]])
    method = open_method(f"h5:{tmp_path / 'f.h5'}")
    method.check([ref])
    assert method.extract(ref.open(None), 2).keypoints.tolist() == [[5, 6]]


def test_precomputed_keypoints_follow_the_resized_image(photo_file, tmp_path):
    half = ImageRef("photo.png", photo_file).open((100, 80))
    write_npz(tmp_path, "photo.png", [[11.5, 21.5]])
    assert open_method(f"npz:{tmp_path}").extract(half, 5).keypoints.tolist() == [[5.5, 10.5]]
    assert open_method(f"npz:{tmp_path}?frame=working").extract(half, 5).keypoints.tolist() == [[11.5, 21.5]]


def test_precomputed_sizes_and_angles_follow_their_keypoints(photo_file, tmp_path):
    half = ImageRef("photo.png", photo_file).open((100, 80))
    more = {"scores": np.float32([1, 2]), "sizes": np.float32([13, 26]), "angles": np.float32([-1, 90])}
    write_npz(tmp_path, "photo.png", [[10, 10], [30, 30]], **more)
    for frame, sizes in (("source", [13, 6.5]), ("working", [26, 13])):
        found = open_method(f"npz:{tmp_path}?frame={frame}").extract(half, 5)
        assert found.sizes.tolist() == pytest.approx(sizes)
        assert found.angles.tolist() == [90, -1]


def test_precomputed_descriptors_in_8_bits_are_no_bits(image, tmp_path):
    points, rows = np.float32([[10, 20], [30, 40]]), np.random.default_rng(0).standard_normal((2, 64))
    rows = np.float32(rows / np.linalg.norm(rows, axis=1, keepdims=True))
    features = Features(points, np.float32([2, 1]), rows, image.pixels.shape[:2])
    (tmp_path / image.name).parent.mkdir(exist_ok=True)
    features.quantized().save(tmp_path / f"{image.name}.npz")
    found = open_method(f"npz:{tmp_path}").extract(image, 5)
    assert found.descriptors.dtype == np.float32
    np.testing.assert_allclose(found.descriptors, rows, rtol=0, atol=0.01)


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


def test_h5_features_that_can_t_be_read(photo_file, tmp_path, monkeypatch):
    image = ImageRef("photo.png", photo_file).open(None)
    file = tmp_path / "f.h5"
    file.write_text("no features")
    method = open_method(f"h5:{file}")
    with monkeypatch.context() as changed:
        changed.setitem(sys.modules, "h5py", None)
        with pytest.raises(EvalError, match=r"h5py.* is not installed: pip install h5py$"):
            method.extract(image, 5)
    pytest.importorskip("h5py")
    with pytest.raises(EvalError, match=r"f\.h5: not an HDF5 file"):
        method.extract(image, 5)
