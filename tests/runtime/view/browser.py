"""A page of elf-view in headless Chromium, and what a script finds in it."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)

needs_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium to open the page in")

_ASK = """<script>
(async () => {
  const loadedImages = () => Promise.all(elements.map((_, number) => loaded(number)));
  let answer;
  try { answer = await (async () => { %s })(); } catch (error) { answer = { failed: String(error) }; }
  const place = document.createElement("pre");
  place.id = "answer";
  place.textContent = JSON.stringify(answer);
  document.body.append(place);
})();
</script>"""


def dom(page: Path, folder: Path) -> str:
    """The document as the browser has it when the scripts are done."""
    assert BROWSER is not None
    command = [
        BROWSER, "--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / 'profile'}",
        "--window-size=1200,800", "--virtual-time-budget=60000", "--dump-dom", page.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True, encoding="utf-8")
    return done.stdout


def ask(page: Path, script: str, folder: Path) -> Any:
    """What the body of an async function returns in the page, whose policy would let no other script run."""
    text = page.read_text(encoding="utf-8")
    text, count = re.subn(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", text)
    assert count == 1
    copy = folder / "asked.html"
    copy.write_text(text.replace("</body>", _ASK % script + "</body>"), encoding="utf-8")
    found = re.search(r'<pre id="answer">(.*?)</pre>', dom(copy, folder), re.DOTALL)
    assert found, "the page's scripts came to no end"
    answer = json.loads(html.unescape(found[1]))
    assert not (isinstance(answer, dict) and "failed" in answer), answer
    return answer
