"""Results that tests make by hand."""

from __future__ import annotations

from elf_eval.metrics.auc import auc
from elf_eval.protocol import Protocol
from elf_eval.report.page import write_report
from elf_eval.run.results import PairResult, Results


def results(pairs, paper_row=None, parameter=None, **protocol):
    names = list(dict.fromkeys(p.method for p in pairs))
    there = {(p.scene, p.pair) for p in pairs}
    about = {"pairs": len(there), "scenes": len({s for s, _ in there}), "images": 0, "sha256": "", "spec": ""}
    return Results(
        protocol=Protocol(**protocol).to_dict(),
        methods=[{"name": name, "paper": paper_row} for name in names],
        skipped=[],
        datasets=[{"name": "set", "parameter": parameter, **about}],
        versions={},
        created="2030-01-01T00:00:00",
        pairs=pairs,
    )


POSED = {"matches": 9, "pose_error": 3.0, "pose_inliers": 7, **{f"pose_auc@{t}": auc(3.0, t) for t in (5, 10, 20)}}


LINED = {"epi_right@1": 6, "epi_right@3": 8, "epi@1": 0.6, "epi@3": 0.8, "epi_median": 0.25}


PLACED = {"rep": 0.5, "ms": 0.25, **{f"mma@{t}": 0.3 for t in range(1, 11)}}


def pair(scene, number, metrics, count=100, method="SIFT", counts="own", parameter=None):
    names = (f"{scene}/0.png", f"{scene}/{number}.png")
    return PairResult("set", scene, *names, method, counts, parameter, {"n1": count, "n2": count, **metrics})


PLANAR = {"h_error": 2.0, "h_inliers": 5, **{f"h_auc@{t}": auc(2.0, t) for t in (1, 3, 5)}}


def page(found, tmp_path, entry=None):
    write_report(found, tmp_path, "Title", "", [entry] if entry else [], "command", [])
    return (tmp_path / "README.md").read_text()
