"""Hooks of mkdocs: the site holds what docs/ links to elsewhere in the repository, under project/.

Pages and pictures are taken as they are; of other files, and of folders without a README, a page is made.  So links are
written for those who read the files, and none of them leaves the site.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
ASSETS = {".png", ".jpg", ".json", ".csv", ".ipynb"}
LINK = re.compile(r"(?<=\]\()([^)\s#:]+)(?=[)#])")
LANGUAGES = {".py": "python", ".c": "c", ".mjs": "javascript", ".toml": "toml", ".yml": "yaml", "": "text"}
UNLISTED = "---\nsearch:\n  exclude: true\n---\n\n"  # of the search; the theme reads it

REQUEST = re.compile(r"<(?:script|link|img|iframe|source)\b[^>]*\b(?:src|href)=[\"']?(?:https?:)?//[^>]*>")

_origins: dict[str, Path] = {}  # what each page outside docs/ is made of


def place(path: Path) -> str:
    """Where a file or folder of the repository is in the site's sources."""
    if path.is_relative_to(DOCS):
        return path.relative_to(DOCS).as_posix()
    name = Path(*(part.lstrip(".") for part in path.relative_to(ROOT).parts))  # mkdocs leaves hidden files out
    if path.is_dir():
        return f"project/{(name / 'index.md').as_posix()}"
    return f"project/{name.as_posix()}" + ("" if path.suffix in {".md", *ASSETS} else ".md")


def targets(text: str, origin: Path) -> Iterator[tuple[str, Path]]:
    """The relative links in a page that lead to something in the repository; a folder's README in place of a folder."""
    for link in LINK.findall(text):
        path = (origin.parent / unquote(link)).resolve()
        if path.exists() and path.is_relative_to(ROOT):
            yield link, path / "README.md" if (path / "README.md").is_file() else path


def rewritten(text: str, origin: Path) -> str:
    """The text of page `origin` with its links as they are in the site."""
    here = posixpath.dirname(place(origin))
    places = {link: posixpath.relpath(place(path), here) for link, path in targets(text, origin)}
    return LINK.sub(lambda match: places.get(match[1], match[1]), text)


def content(path: Path) -> str:
    """The text of the page that stands for `path`."""
    name = path.relative_to(ROOT).as_posix()
    if path.suffix == ".md":
        return path.read_text(encoding="utf-8")
    if path.is_file():
        text = path.read_text(encoding="utf-8").rstrip("\n")
        return f"{UNLISTED}# `{name}`\n\n````{LANGUAGES.get(path.suffix, 'text')}\n{text}\n````\n"
    files = sorted(file.name for file in path.iterdir() if file.is_file())
    rows = [f"- [`{file}`]({path.name}/{file})" for file in files if not file.startswith(".")]
    return f"{UNLISTED}# `{name}/`\n\n" + "\n".join(rows) + "\n"


def outside() -> set[Path]:
    """All that the site needs from outside docs/: what its pages link to, and what these link to."""
    found: set[Path] = set()
    waiting = list(DOCS.rglob("*.md"))
    while waiting:
        page = waiting.pop()
        for _, path in targets(content(page), page):
            if path not in found and not path.is_relative_to(DOCS):
                found.add(path)
                waiting += [path] if path.suffix == ".md" or path.is_dir() else []
    return found


def on_files(files: Any, config: Any) -> Any:
    from mkdocs.structure.files import File

    for path in sorted(outside()):
        if path.suffix in ASSETS:
            files.append(File.generated(config, place(path), abs_src_path=str(path)))
        else:
            files.append(File.generated(config, place(path), content=content(path)))
            _origins[place(path)] = path
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    uri = page.file.src_uri
    return rewritten(markdown, _origins.get(uri, DOCS / uri))


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """Refuse a page that would load something from another server."""
    from mkdocs.exceptions import PluginError

    requests = REQUEST.findall(output)
    if requests:
        raise PluginError(f"{page.file.src_uri} loads from another server: {', '.join(requests)}")
    return output
