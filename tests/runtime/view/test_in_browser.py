"""The page in a browser: its keypoints and matches are the runtime's, and a name runs no script."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from elf_runtime import ElfRuntime, Features, match
from elf_runtime.view.page import write_page
from elf_runtime.view.shown import ScoreMap, Shown, detected
from helpers import textured

from .browser import ask, dom, needs_browser

pytestmark = needs_browser

TRIED: list[dict[str, Any]] = [
    {},
    {"level": 60},
    {"level": 180, "count": 60},
    {"count": 25},
    {"radius": 2},
    {"radius": 14},
    {"level": 0, "radius": 9, "count": 200},
    {"level": 30, "radius": 1, "count": 3000},
]
KEYPOINTS = """
const tried = %s, answers = [];
for (const { image } of await loadedImages())
  answers.push(tried.map((settings) => keypointsOf(image, { ...ownSettings(image), ...settings })));
return answers;"""


def shifted(seed: int) -> npt.NDArray[np.uint8]:
    """Two views of one scene: the second is moved, darker and grey."""
    scene = textured(300, 400)
    return scene[:240, :320] if seed == 0 else (scene[20:260, 30:350] * 0.7).astype(np.uint8)


@pytest.fixture(scope="module", params=[{}, {"scale": 1.0, "suppression": "greedy", "border": 3}, {"quantize": True}])
def settings(request: pytest.FixtureRequest) -> dict[str, Any]:
    return dict(request.param)


@pytest.fixture(scope="module")
def elf() -> ElfRuntime:
    return ElfRuntime()


@pytest.fixture(scope="module")
def images(elf: ElfRuntime, settings: dict[str, Any]) -> list[Shown]:
    return [detected(elf, f"{i}.png", shifted(i), elf.params(**settings)) for i in range(2)]


@pytest.fixture(scope="module")
def answers(images: list[Shown], tmp_path_factory: pytest.TempPathFactory) -> list[list[list[dict[str, float]]]]:
    folder = tmp_path_factory.mktemp("page")
    write_page(folder / "view.html", "two views", images)
    return list(ask(folder / "view.html", KEYPOINTS % json.dumps(TRIED), folder))


def plain_loop(map_: ScoreMap, tried: dict[str, Any]) -> list[int]:
    """Pixels of the stored map: by descending score, each not in the window of one taken."""
    scores = map_.scores * map_.step
    level = tried.get("level", map_.level)
    radius = map_.radii[tried.get("radius", map_.params.nms_radius)]
    height, width = scores.shape
    order = sorted((-scores[y, x], y, x) for y in range(height) for x in range(width) if scores[y, x] > 0)
    taken: list[tuple[int, int]] = []
    for negative, y, x in order:
        window = scores[max(0, y - radius) : y + radius + 1, max(0, x - radius) : x + radius + 1]
        if not map_.permitted[y, x] or -negative < level:
            continue
        if map_.params.suppression == "maxima" and window.max() > -negative:
            continue
        if all(max(abs(y - v), abs(x - u)) > radius for v, u in taken):
            taken.append((y, x))
        if len(taken) == tried.get("count", map_.params.max_keypoints):
            break
    return [y * width + x for y, x in taken]


def test_keypoints_are_those_of_a_plain_loop_on_the_stored_map(images: list[Shown], answers: list[Any]) -> None:
    for image, found in zip(images, answers, strict=True):
        assert image.map is not None
        for tried, keypoints in zip(TRIED, found, strict=True):
            assert [point["pixel"] for point in keypoints] == plain_loop(image.map, tried), tried
            assert len(keypoints) >= 20


def test_keypoints_are_those_of_the_runtime(
    elf: ElfRuntime, settings: dict[str, Any], images: list[Shown], answers: list[Any]
) -> None:
    """All but a few: scores of 16 bits may be equal where floats are not.

    With settings that are tried, a slope that "greedy" takes is placed to a working pixel, the source's here.
    """
    for number, found in enumerate(answers):
        for tried, keypoints in zip(TRIED, found, strict=True):
            names = {"level": "threshold", "count": "max_keypoints", "radius": "nms_radius"}
            own = {names[name]: value / 255 if name == "level" else value for name, value in tried.items()}
            wanted = elf.detect(shifted(number), **{**settings, **own})
            places = np.array([(point["x"], point["y"]) for point in keypoints])
            assert abs(len(places) - len(wanted)) <= 0.01 * len(wanted), tried
            nearest = np.abs(wanted.keypoints[:, None] - places[None]).max(axis=2).min(axis=1)
            near = 1.01 if tried and settings.get("suppression") == "greedy" else 0.01
            assert (nearest < near).mean() >= 0.98, tried
            scores = [point["score"] for point in keypoints]
            assert scores == sorted(scores, reverse=True)
            assert scores[0] == pytest.approx(wanted.scores[0], abs=0.01)
        assert len(found[0]) == pytest.approx(len(elf.detect(shifted(number), **settings)), abs=2)


def test_matches_are_those_of_the_runtime(
    elf: ElfRuntime, settings: dict[str, Any], images: list[Shown], tmp_path: Path
) -> None:
    write_page(tmp_path / "view.html", "two views", images)
    script = """
    const [a, b] = (await loadedImages()).map(({ image }) =>
      ({ image, keypoints: keypointsOf(image, ownSettings(image)) }));
    return mutualMatches(a.image, a.keypoints, b.image, b.keypoints).map(([i, j]) =>
      [a.keypoints[i].x, a.keypoints[i].y, b.keypoints[j].x, b.keypoints[j].y,
       similarity(a.image.candidates, a.keypoints[i].candidate, b.image.candidates, b.keypoints[j].candidate)]);"""
    found = np.array(ask(tmp_path / "view.html", script, tmp_path))
    a, b = (elf.detect(shifted(i), **settings).quantized() for i in range(2))
    pairs = match(a, b)
    wanted = {tuple(row) for row in np.rint(np.hstack([a.keypoints[pairs[:, 0]], b.keypoints[pairs[:, 1]]])).tolist()}
    same = [tuple(row) in wanted for row in np.rint(found[:, :4]).tolist()]
    assert len(pairs) > 30
    assert abs(len(found) - len(pairs)) <= 0.05 * len(pairs)
    assert np.mean(same) > 0.95
    assert ((found[:, 4] > 0.3) & (found[:, 4] <= 1)).all()


def test_the_page_as_it_is_shows_its_images(images: list[Shown], tmp_path: Path) -> None:
    write_page(tmp_path / "view.html", "two views", images)
    shown = dom(tmp_path / "view.html", tmp_path)
    assert 'class="left"' in shown
    assert 'class="right"' in shown
    assert "0.png: " in shown
    assert "keypoints, 320x240" in shown


def test_pointing_keys_and_sliders(images: list[Shown], tmp_path: Path) -> None:
    write_page(tmp_path / "view.html", "two views", [*images, *images])
    script = """
    const settled = async (want) => { while (!want()) await new Promise((done) => setTimeout(done, 20)); };
    await settled(() => sides.length === 2);
    const texts = [];
    const at = onStage(boxes[0], sides[0].keypoints[3]);
    const place = byId("stage").getBoundingClientRect();
    const where = { clientX: place.x + at[0], clientY: place.y + at[1] };
    byId("stage").dispatchEvent(new MouseEvent("mousemove", where));
    texts.push(byId("status").textContent);
    byId("stage").dispatchEvent(new MouseEvent("mouseleave"));
    byId("count").value = 30;
    byId("count").dispatchEvent(new Event("input"));
    texts.push(byId("status").textContent);
    byId("reset").click();
    texts.push(byId("status").textContent);
    for (const id of ["overlay", "lines"]) byId(id).click();
    texts.push(byId("status").textContent);
    document.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft", bubbles: true }));
    await settled(() => sides[0].number === 3);
    document.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowDown", bubbles: true }));
    await settled(() => sides[1].number === 2);
    return [...texts, document.querySelector("nav .left span").textContent];"""
    pointed, few, own, matched, left = ask(tmp_path / "view.html", script, tmp_path)
    assert "0.png: x " in pointed
    assert "in 1.png: x " in pointed
    assert few.count(": 30 keypoints") == 2
    assert ": 30 keypoints" not in own
    assert "mutual matches" in matched
    assert left == "1.png"


def test_a_name_runs_no_script_and_loads_nothing(elf: ElfRuntime, tmp_path: Path) -> None:
    evil = "</script><script>document.title='evil'</script><img src=x onerror=\"document.title='evil'\">\x07&amp;.png"
    image = detected(elf, evil, shifted(0), elf.params())
    write_page(tmp_path / "view.html", evil, [image])
    shown = dom(tmp_path / "view.html", tmp_path)
    assert "<title>evil" not in shown
    assert '<img src="x"' not in shown
    script = "return [document.title, document.querySelector('nav span').textContent, document.images.length];"
    escaped = evil.replace("\x07", "\\x07")
    assert ask(tmp_path / "view.html", script, tmp_path) == [escaped, escaped, 1]


def test_without_a_map_or_an_image_there_are_the_keypoints_of_the_file(elf: ElfRuntime, tmp_path: Path) -> None:
    found: Features = elf.detect(shifted(0)).quantized()
    images = [Shown("a", None, found, None, "no image"), Shown("b", shifted(0), found[:0], None, "none found")]
    write_page(tmp_path / "view.html", "files", images)
    script = """
    const images = (await loadedImages()).map((one) => one.image);
    return [{}, { count: 7 }, { level: %r }].map((settings) =>
      images.map((image) => keypointsOf(image, { ...ownSettings(image), ...settings }).length));"""
    level = float(np.median(found.scores))
    answer = ask(tmp_path / "view.html", script % level, tmp_path)
    assert answer == [[len(found), 0], [7, 0], [int((found.scores >= level).sum()), 0]]


def test_pictures_are_shrunk(elf: ElfRuntime, tmp_path: Path) -> None:
    large = cv2.resize(shifted(0), (2000, 1500))
    image = detected(elf, "large", large, elf.params(scale=0.2))
    write_page(tmp_path / "view.html", "large", [image])
    script = """
    const [{ picture, image }] = await loadedImages();
    return [picture.naturalWidth, picture.naturalHeight, image.width];"""
    assert ask(tmp_path / "view.html", script, tmp_path) == [1600, 1200, 2000]
