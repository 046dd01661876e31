"""The page of a run."""

from __future__ import annotations

from dataclasses import replace

from made_results import LINED, PLACED, PLANAR, POSED, page, pair, results


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


def test_a_page_says_what_an_epipolar_distance_is(tmp_path):
    assert "Hartley and Zisserman, 11.10" in page(results([pair("a", 1, LINED)]), tmp_path / "lined")
    assert "Hartley" not in page(results([pair("a", 1, POSED)]), tmp_path / "posed")


def test_a_page_states_the_ratios(tmp_path):
    found = results([pair("a", 1, PLANAR, method=name) for name in ("SIFT", "ELF", "ORB")])
    say = "below a ratio of that to the second nearest in the second image: "
    assert say not in page(found, tmp_path / "none")

    def ratios(*values):
        return replace(found, methods=[{**m, "ratio": v} for m, v in zip(found.methods, values, strict=True)])

    assert say + "SIFT 0.8, ELF 0.9, ORB none." in page(ratios(0.8, 0.9, None), tmp_path / "each")
    assert say + "0.8." in page(ratios(0.8, 0.8, 0.8), tmp_path / "all")


def test_a_page_says_whose_matches_are_refined(tmp_path):
    found = results([pair("a", 1, PLANAR, method=name) for name in ("SIFT", "ELF", "ORB")])
    assert "elf_runtime.refine" not in page(found, tmp_path / "none")

    def refined(*values):
        return replace(found, methods=[{**m, "refine": v} for m, v in zip(found.methods, values, strict=True)])

    assert "Matches of SIFT, ORB are refined: " in page(refined(True, False, True), tmp_path / "some")
    assert "Matches are refined: " in page(refined(True, True, True), tmp_path / "all")
    assert "elf_runtime.refine" not in page(refined(False, False, False), tmp_path / "no")
