"""Where the examples are, and a picture to run them on."""

from __future__ import annotations

from helpers import ROOT, textured

EXAMPLES = ROOT / "examples"
PICTURE = textured(96, 130)
