"""A hook of mkdocs: each page of the site has the structure that GitHub gives it.

Python-Markdown wants four spaces where GitHub takes two or three, and a blank line before a list; what is written
otherwise becomes running text, without a word.  Here both read the page, and one that differs ends the build.
"""

from __future__ import annotations

import html as entities
import re
import textwrap
from collections import Counter
from typing import Any

# The first paragraph of an item is left out: whether it is one at all depends on blank lines elsewhere in the list.
ELEMENT = re.compile(r"<(ul|ol|li|table|tr|td|th|h[1-6]|img|pre|strong|em|(?<!<li><)(?<!<li>\n<)p)\b")
CODE = re.compile(r"<pre\b[^>]*>(.*?)</pre>", re.DOTALL)
ADVICE = "what belongs to an item of a list has four spaces before it, with blank lines around; code there is fenced"


def as_github(markdown: str) -> str:
    """The HTML of a page as CommonMark with GitHub's tables has it."""
    from markdown_it import MarkdownIt

    return str(MarkdownIt("commonmark").enable(["table", "strikethrough"]).render(markdown))


def blocks_of_code(html: str) -> list[str]:
    """The texts of the blocks of code, without colours and common indentation, in order."""
    texts = [entities.unescape(re.sub(r"<[^>]*>", "", code)) for code in CODE.findall(html)]
    return [textwrap.dedent(text).strip("\n") for text in texts]


def differences(wanted: str, found: str) -> list[str]:
    """How the HTML `found` of a page differs from `wanted` in blocks of code and in numbers of elements."""
    blocks = blocks_of_code(found)
    said = [f"lost code {code.splitlines()[0]!r}" for code in blocks_of_code(wanted) if code and code not in blocks]
    count, counted = Counter(ELEMENT.findall(wanted)), Counter(ELEMENT.findall(found))
    return said + [
        f"{counted[tag]} <{tag}>, not {count[tag]}" for tag in sorted(count | counted) if count[tag] != counted[tag]
    ]


def on_page_content(html: str, page: Any, **_: Any) -> str:
    from mkdocs.exceptions import PluginError

    if re.search(r"^::: ", page.markdown, re.MULTILINE):  # the page has docstrings, which its text has not
        return html
    said = differences(as_github(page.markdown), html)
    if said:
        raise PluginError(f"{page.file.src_uri} is not as GitHub shows it: {'; '.join(said)} ({ADVICE})")
    return html
