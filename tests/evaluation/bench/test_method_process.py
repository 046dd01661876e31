"""A method in a process of its own."""

from __future__ import annotations

import cv2
import pytest

from elf_eval.bench.method_process import MethodProcess
from elf_eval.data.images import ImageRef
from elf_eval.errors import EvalError
from elf_eval.methods import open_methods


def test_it_finds_what_the_method_finds_here(photo_file):
    ref = ImageRef("photo.png", photo_file)
    here = open_methods("orb", None, 1).extract(ref.open((200, 150)), 40)
    with MethodProcess("orb", None, ref, (200, 150), 40, 1) as method:
        assert [method.run(), method.run()] == [len(here)] * 2
        process = method._process
        assert process.is_alive()
    assert not process.is_alive()


def test_a_method_that_does_not_open_says_why_here(photo_file):
    with pytest.raises(EvalError, match="nothing-of-the-kind"):
        MethodProcess("nothing-of-the-kind", None, ImageRef("photo.png", photo_file), None, 40, 1)


def test_an_image_that_can_not_be_read_is_an_error(tmp_path):
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"no image")
    assert cv2.imread(str(broken)) is None
    with pytest.raises(EvalError, match="broken"):
        MethodProcess("orb", None, ImageRef("broken.png", broken), None, 40, 1)


def test_a_process_that_dies_is_an_error(photo_file):
    with MethodProcess("orb", None, ImageRef("photo.png", photo_file), None, 40, 1) as method:
        method._process.kill()
        method._process.join()
        with pytest.raises(EvalError, match="ended"):
            method.run()
