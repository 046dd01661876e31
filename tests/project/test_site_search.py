"""The search of the site in pages that are opened from the file system, where browsers start no worker."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers import ROOT
from project.chromium import BROWSER, browser

FRAME = "javascripts/iframe-worker.js"
PAGE = """<!doctype html><title>page</title><body><script src="frame.js"></script><script>
window.said = [];
const worker = new Worker(new URL('worker.js', location));
worker.addEventListener('message', (event) => window.said.push(event.data.words));
for (const words of [['a', 'b'], ['c']]) worker.postMessage({ words });
</script>"""
WORKER = "addEventListener('message', async ({ data }) => postMessage({ words: data.words.reverse() }));"


def test_the_site_takes_its_own_script_for_it() -> None:
    configuration = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert f"polyfills: [{FRAME}]" in configuration
    assert "- offline" in configuration


@pytest.mark.skipif(BROWSER is None, reason="no Chromium to open the page in")
def test_a_frame_does_what_a_worker_does(tmp_path: Path) -> None:
    (tmp_path / "frame.js").write_text((ROOT / "docs" / FRAME).read_text(encoding="utf-8"))
    (tmp_path / "page.html").write_text(PAGE)
    (tmp_path / "worker.js").write_text(WORKER)
    with browser(tmp_path) as page:
        page.open((tmp_path / "page.html").as_uri())
        page.wait("window.said?.length === 2")
        assert page.ask("window.said") == [["b", "a"], ["c"]]
