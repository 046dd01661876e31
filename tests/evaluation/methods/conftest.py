"""An image for the methods."""

from __future__ import annotations

import pytest

from elf_eval.data.images import ImageRef


@pytest.fixture
def image(photo_file):
    return ImageRef("scene/photo.png", photo_file).open(None)
