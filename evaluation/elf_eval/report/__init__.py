"""From results to tables, plots, pictures and a page."""

from __future__ import annotations

from .page import write_index, write_report
from .pictures import write_pictures

__all__ = ["write_index", "write_pictures", "write_report"]
