"""A table of text, as Markdown."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """Cells of text, with a caption above."""

    caption: str
    header: list[str]
    rows: list[list[str]]

    def markdown(self) -> str:
        """GitHub's pipe table."""
        lines = [self.header, ["---"] * len(self.header), *self.rows]
        body = "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
        return f"**{self.caption}**\n\n{body}"
