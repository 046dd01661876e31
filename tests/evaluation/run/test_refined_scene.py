"""Refined matches of a calibrated scene, where it is at hand: how far they lie from their true epipolar lines."""

from __future__ import annotations

import json

from elf_eval.cli import main


def test_refined_matches_lie_on_their_epipolar_lines(shared, tmp_path):
    scene = shared / "data" / "strecha" / "entry-P10"
    folder = tmp_path / "entry"
    for part in ("images", "gt_dense_cameras"):
        (folder / part).mkdir(parents=True)
        for index in range(3):
            name = f"{index:04}.jpg" + (".camera" if part == "gt_dense_cameras" else "")
            (folder / part / name).symlink_to(scene / part / name)
    method = "elf?preset=accurate&ratio=0.9"
    args = ["--dataset", f"entry=strecha:{folder}?step=1", "--size", "1536x1024", "--max-keypoints", "1000"]
    args += ["--threads", "1", "--out", str(tmp_path / "out"), "--cache", str(tmp_path / "cache")]
    assert main(["run", *args, "--detector", method, "--detector", f"{method}&refine=true"]) in (None, 0)
    pairs = json.loads((tmp_path / "out" / "results.json").read_text())["pairs"]
    assert len(pairs) == 4
    found = {(pair["first"], pair["method"]): pair["metrics"] for pair in pairs}
    for (first, name), refined in found.items():
        if name != method:
            detected = found[first, method]
            assert refined["epi_median"] < 0.13 < detected["epi_median"]
            assert refined["epi_right@1"] > detected["epi_right@1"] > 200
            assert refined["matches"] == detected["matches"]
