"""Tables, and their lines of text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


def columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows as lines: the first column and units aligned left, the others right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    last = len(widths) - 1
    left = {0, last} if rows[0][-1] == "unit" else {0}
    lines = []
    for row in rows:
        cells = [
            cell.ljust(width) if i in left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return lines


@dataclass(frozen=True)
class Table:
    """caption: what it holds; head: names of columns; rows: cells, the first names the row."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def lines(self) -> list[str]:
        """As text; the caption stands where a page has the name of the first column."""
        return columns([(self.caption.lower(), *self.head[1:]), *self.rows])
