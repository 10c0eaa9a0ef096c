"""Tables as notebooks show them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

CELL = "text-align:right;padding:1px 8px"
FIRST = "text-align:left;padding:1px 8px"


def row(cells: Sequence[str], last: str = "", tag: str = "td") -> str:
    """A row whose first cell stands left, the others right; last: a cell as it is."""
    first, *others = (escape(cell) for cell in cells)
    further = "".join(f'<{tag} style="{CELL}">{cell}</{tag}>' for cell in others)
    return f'<tr><{tag} style="{FIRST}">{first}</{tag}>{further}{last}</tr>'


def framed(head: Sequence[str], rows: Iterable[str]) -> str:
    """A table of rows."""
    return f"<table>{row(head, tag='th')}{''.join(rows)}</table>"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of texts."""
    return framed(head, map(row, rows))
