"""A part of a page: sentences, tables and figures in their order; also as a page of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from loopcal.figures.figure import Figure
from loopcal.presentation.shown import Table
from loopcal.report.templates import page

Part = Table | Figure | str | None
"""A text is shown as it was printed; None is what cannot be drawn."""


@dataclass(frozen=True, eq=False)
class Section:
    """key: names it and its figures in the page; words: a sentence each; parts: below them."""

    key: str
    title: str
    words: Sequence[str]
    parts: Sequence[Part]


def section_page(kind: str, section: Section, about: Mapping[str, object]) -> str:
    """One self-contained page; nothing in it is asked of any network."""
    return page("section.html", title=section.title, about=about, kind=kind, section=section)
