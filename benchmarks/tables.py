"""Tables of Markdown, and where they go in a document."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table whose first column is text and whose others are numbers."""
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]

    def line(cells: Sequence[str]) -> str:
        first = cells[0].ljust(widths[0])
        rest = (cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True))
        return "| " + " | ".join([first, *rest]) + " |"

    rule = "| " + " | ".join(
        "-" * w if i == 0 else "-" * (w - 1) + ":" for i, w in enumerate(widths)
    )
    return "\n".join([line(head), rule + " |", *map(line, rows)])


def milliseconds(seconds: float) -> str:
    """Three digits at least."""
    value = seconds * 1e3
    return f"{value:,.2f}" if value < 10 else f"{value:,.1f}" if value < 100 else f"{value:,.0f}"


def times_as_long(ratio: float) -> str:
    """How many times longer, three digits or all before the point."""
    return f"{ratio:,.0f}" if ratio >= 100 else f"{ratio:.3g}"


def met(holds: bool) -> str:
    """Of something demanded."""
    return "met" if holds else "missed"


def write_into(document: Path, block: str, text: str) -> None:
    """Replace what a former run measured, between two markers, by what this one did."""
    begin, end = (f"<!-- {block}: {edge} -->" for edge in ("begin", "end"))
    content = document.read_text(encoding="utf-8")
    ahead, rest = content.split(begin)
    _, behind = rest.split(end)
    document.write_text(f"{ahead}{begin}\n{text}\n{end}{behind}", encoding="utf-8")
