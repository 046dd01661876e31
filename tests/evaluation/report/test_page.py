"""The page of a run."""

from __future__ import annotations

from made_results import PLACED, PLANAR, POSED, page, pair, results


def test_a_page_names_the_estimator_of_what_it_shows(tmp_path):
    posed = page(results([pair("a", 1, POSED)]), tmp_path / "posed")
    say = "Relative poses, through the essential matrix, from mutual nearest neighbours by OpenCV's RANSAC: 1 px, 1000 "
    assert say in posed
    assert "MAGSAC" not in posed
    planar = page(results([pair("a", 1, {**PLACED, **PLANAR})]), tmp_path / "planar")
    assert "Homographies from mutual nearest neighbours by OpenCV's USAC_MAGSAC: 3 px, 10000 " in planar
    assert "essential" not in planar
    assert all("rises in a step at each error" in text and "As SuperGlue" in text for text in (posed, planar))
    assert "AUC" not in page(results([pair("a", 1, {})]), tmp_path / "none")
