"""A table of text, as Markdown and as HTML."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape


@dataclass(frozen=True)
class Table:
    """Cells of text; `caption` stands above."""

    caption: str
    header: list[str]
    rows: list[list[str]]

    def markdown(self) -> str:
        """GitHub's pipe table."""
        lines = [self.header, ["---"] * len(self.header), *self.rows]
        body = "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
        return f"**{self.caption}**\n\n{body}\n"

    def html(self) -> str:
        """A ``<table>``."""
        head = "".join(f"<th>{escape(cell)}</th>" for cell in self.header)
        rows = "\n".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in self.rows)
        return f"<table><caption>{escape(self.caption)}</caption>\n<tr>{head}</tr>\n{rows}\n</table>"
