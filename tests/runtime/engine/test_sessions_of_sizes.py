"""Which sizes of image get a session of their own, when it opens, and when it goes."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from elf_runtime import ElfRuntime
from elf_runtime.model import sessions
from helpers import TINY, textured


def count_sessions(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, int]]:
    """The dims of each session that is opened from here on."""
    opened: list[dict[str, int]] = []
    real = sessions.open_session

    def spy(*args: Any, **options: Any) -> Any:
        opened.append(dict(options.get("dims") or {}))
        return real(*args, **options)

    monkeypatch.setattr(sessions, "open_session", spy)
    return opened


@pytest.mark.parametrize(("scale", "working"), [(None, (54, 72)), (1.0, (120, 160)), (0.75, (90, 120))])
def test_warmup_opens_the_session_that_detect_uses(
    monkeypatch: pytest.MonkeyPatch, scale: float | None, working: tuple[int, int]
) -> None:
    elf = ElfRuntime()  # its own scale is 0.45
    opened = count_sessions(monkeypatch)
    elf.warmup((120, 160), scale=scale)
    assert opened == [{"N": 1, "H": working[0], "W": working[1]}]
    elf.detect(textured(120, 160), scale=scale)
    assert len(opened) == 1
    elf.warmup((120, 160), preset="fast")
    elf.detect(textured(120, 160), preset="fast")
    assert opened[1:] == [{"N": 1, "H": 40, "W": 53}]


def test_the_model_is_checked_once_and_opened_once_for_a_size(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = count_sessions(monkeypatch)
    elf = ElfRuntime(TINY)
    assert opened == [{}]
    elf.detect(textured(64, 80))
    elf.detect(textured(64, 80, seed=1))
    assert opened == [{}, {"N": 1, "H": 64, "W": 80}]


def test_a_batch_is_no_other_size(monkeypatch: pytest.MonkeyPatch) -> None:
    elf = ElfRuntime(TINY, threads=1, sizes=1)
    images = [textured(64, 80, seed) for seed in range(5)]
    opened = count_sessions(monkeypatch)
    batch = elf.detect_batch(images)  # four together and one alone
    assert opened == [{"H": 64, "W": 80}, {"N": 1, "H": 64, "W": 80}]
    alone = [elf.detect(image) for image in images]
    for number in (5, 3, 2):
        elf.detect_batch(images[:number])
    assert len(opened) == 2
    for found, wanted in zip(batch, alone, strict=True):
        np.testing.assert_allclose(found.keypoints, wanted.keypoints, atol=1e-3)
    elf.warmup((48, 80))
    assert len(elf._network.sessions) == 1
    for _ in range(2):
        elf.detect_batch(images[:4])
    elf.detect_batch(images[4:])
    assert opened[3:] == [{}, {"H": 64, "W": 80}, {"N": 1, "H": 64, "W": 80}]


def test_images_of_ever_new_sizes_share_one_session(monkeypatch: pytest.MonkeyPatch) -> None:
    elf = ElfRuntime(TINY, threads=1)
    opened = count_sessions(monkeypatch)
    for side in range(64, 70):
        elf.detect(textured(side, 80))
    elf.detect_batch([textured(70, 80, seed) for seed in range(2)])
    assert opened == [{"N": 1, "H": 64, "W": 80}, {}]
    assert len(elf._network.sessions) == 2


def test_a_size_that_comes_again_gets_its_session(monkeypatch: pytest.MonkeyPatch) -> None:
    elf = ElfRuntime(TINY, threads=1, sizes=2)
    opened = count_sessions(monkeypatch)
    a, b, c = (textured(side, 80) for side in (64, 48, 56))
    for image in (a, b, a, b, a, b):
        elf.detect(image)
    assert opened == [{"N": 1, "H": 64, "W": 80}, {}, {"N": 1, "H": 48, "W": 80}]
    assert len(elf._network.sessions) == 2  # the one of any size has gone
    del opened[:]
    for image in (c, a, b) * 3:  # more than are kept: none is among the last two when it comes again
        elf.detect(image)
    assert opened == [{}]


def test_warmup_opens_the_session_of_a_further_size_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    elf = ElfRuntime(TINY, threads=1)
    opened = count_sessions(monkeypatch)
    for side in (64, 48):
        elf.warmup((side, 80))
    elf.detect(textured(48, 80))
    assert opened == [{"N": 1, "H": 64, "W": 80}, {"N": 1, "H": 48, "W": 80}]


def test_other_providers_open_one_session_a_size(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sessions, "is_cpu", lambda _: False)
    elf = ElfRuntime(TINY, threads=1)
    opened = count_sessions(monkeypatch)
    for side in (64, 48, 64, 48):
        elf.detect(textured(side, 80))
    assert opened == [{"N": 1, "H": 64, "W": 80}, {"N": 1, "H": 48, "W": 80}]


def test_the_bundled_model_gives_the_same_bits_in_the_session_of_any_size() -> None:
    elf, image = ElfRuntime(threads=1), textured(120, 160)
    elf.detect(textured(96, 128))
    any_size, own = elf.trace(image), elf.trace(image)
    assert len(elf._network.sessions) == 2
    assert len(own.features) > 15
    np.testing.assert_array_equal(any_size.saliency, own.saliency)
    np.testing.assert_array_equal(any_size.features.keypoints, own.features.keypoints)
    np.testing.assert_array_equal(any_size.features.descriptors, own.features.descriptors)


def test_the_sizes_used_last_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    elf = ElfRuntime(TINY, threads=1, sizes=2)
    a, b, c = (textured(side, 80) for side in (64, 48, 56))
    opened = count_sessions(monkeypatch)
    for image in (a, b):
        elf.warmup(image.shape[:2])
        elf.detect_batch([image] * 2)
    elf.detect(a)  # now b is the one that was not used for longest
    elf.warmup(c.shape[:2])
    assert len(opened) == 5
    elf.detect(a)
    elf.detect_batch([a] * 3)
    assert len(opened) == 5
    elf.warmup(b.shape[:2])
    assert len(opened) == 6


def test_the_size_used_longest_ago_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    elf = ElfRuntime(TINY, threads=1, sizes=2)
    a, b, c = (textured(side, 80) for side in (64, 48, 56))
    opened = count_sessions(monkeypatch)
    for image in (a, b, c, b, c):
        elf.warmup(image.shape[:2])
    assert len(opened) == 3
    elf.warmup(a.shape[:2])
    assert len(opened) == 4


def test_the_session_of_any_size_goes_when_one_of_a_size_opens(monkeypatch: pytest.MonkeyPatch) -> None:
    """On other providers than the CPU, the session that checks the model is a whole one."""
    monkeypatch.setattr(sessions, "is_cpu", lambda _: False)
    elf = ElfRuntime(TINY, threads=1)
    assert len(elf._network.sessions) == 1
    elf.detect(textured(64, 80))
    assert len(elf._network.sessions) == 1


def test_a_part_of_the_graph_costs_the_whole_one_no_session(monkeypatch: pytest.MonkeyPatch) -> None:
    elf = ElfRuntime(TINY, threads=1, sizes=1)
    opened = count_sessions(monkeypatch)
    elf.detect(textured(64, 80))
    elf.saliency(textured(48, 80))
    elf.detect(textured(64, 80))
    assert len(opened) == 2


def test_threads_that_want_the_same_session_open_one(monkeypatch: pytest.MonkeyPatch) -> None:
    elf = ElfRuntime(TINY, threads=1)
    opened = count_sessions(monkeypatch)
    spy = sessions.open_session

    def slowly(*args: Any, **options: Any) -> Any:
        time.sleep(0.1)
        return spy(*args, **options)

    monkeypatch.setattr(sessions, "open_session", slowly)
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(elf.detect, [textured(64, 80)] * 2))
    assert len(opened) == 1


def test_without_sizes_one_session_does_all(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = count_sessions(monkeypatch)
    elf = ElfRuntime(sizes=0)
    elf.detect(textured(96, 80))
    elf.detect(textured(80, 64))
    assert opened == [{}]


def test_an_image_s_scales_are_one_size(monkeypatch: pytest.MonkeyPatch) -> None:
    elf = ElfRuntime(TINY, threads=1, sizes=1)
    opened = count_sessions(monkeypatch)
    for seed in range(3):
        elf.detect(textured(120, 160, seed), scales=(0.3, 0.6, 1.2))
    assert [dims["H"] for dims in opened] == [144, 72, 36]
    assert len(elf._network.sessions) == 3
    elf.detect(textured(60, 80), scales=(0.6, 1.2))  # of sizes that are there
    assert len(opened) == 3
    for _ in range(2):
        elf.detect(textured(80, 80), scales=(0.3, 0.6, 1.2))
    assert [dims.get("H") for dims in opened[3:]] == [None, 96, 48, 32]
    assert len(elf._network.sessions) == 3


def test_warmup_opens_the_session_of_every_scale(monkeypatch: pytest.MonkeyPatch) -> None:
    elf = ElfRuntime(TINY, threads=1)
    elf.detect(textured(64, 80))
    opened = count_sessions(monkeypatch)
    for size in ((120, 160), (96, 128)):
        elf.warmup(size, params=elf.params(scales=(0.5, 1.0)))
    assert [dims["H"] for dims in opened] == [120, 60, 96, 48]
    for size in ((96, 128), (120, 160)):
        elf.detect(textured(*size), scales=(0.5, 1.0))
    assert len(opened) == 4
    assert len(elf._network.sessions) == 4  # those of the first image have made room


def test_scales_open_no_session_again_and_again_on_other_providers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sessions, "is_cpu", lambda _: False)
    elf = ElfRuntime(TINY, threads=1, sizes=1)
    opened = count_sessions(monkeypatch)
    for seed in range(3):
        elf.detect(textured(120, 160, seed), scales=(0.3, 0.6, 1.2))
    assert len(opened) == 3
