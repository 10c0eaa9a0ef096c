"""The templates of all pages, and parts that are put into them as they are."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping, Sequence
from datetime import date
from functools import cache
from typing import TYPE_CHECKING, Any

from loopcal.figures.figure import plotly_javascript
from loopcal.files.versions import version
from loopcal.presentation.wrapped import shortened
from loopcal.report.glossary import meaning

if TYPE_CHECKING:
    from jinja2 import Environment

CELL = 16
"""Characters of a cell that paper never breaks; a longer one may wrap."""


def sha256(text: str) -> str:
    """For a content security policy."""
    return base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")


@cache
def environment() -> Environment:
    """The templates of this package; whatever is put into them is escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    # StrictUndefined: a name that a template misspells raises instead of printing nothing.
    made = Environment(
        loader=PackageLoader("loopcal.report", "template"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals |= {"meaning": meaning, "shortened": shortened, "CELL": CELL, "widths": widths}
    return made


def part(name: str) -> str:
    """The text of a part that is no template."""
    templates = environment()
    assert templates.loader is not None
    return templates.loader.get_source(templates, name)[0]


def widths(head: Sequence[str], rows: Sequence[Sequence[str]]) -> int:
    """Characters that the columns of a table need side by side, so that paper can scale it."""
    words = [max(map(len, cell.split()), default=0) for cell in head]
    columns = zip(*rows, strict=True) if rows else ((),) * len(head)
    return sum(
        max(word, *(min(len(cell), CELL) for cell in column), 1)
        for word, column in zip(words, columns, strict=True)
    )


def today() -> str:
    """The day on which a page is written, which it states where nothing else says when."""
    return date.today().isoformat()


def page(template: str, *, title: str, about: Mapping[str, object], **content: Any) -> str:
    """A self-contained page with figures; nothing in it is asked of any network.

    about: what stands below the title: files, numbers of poses; the day is added.
    """
    # The page's security policy runs scripts by their hash, and no others.
    program, drawing = plotly_javascript(), part("draw.js")
    return (
        environment()
        .get_template(template)
        .render(
            title=title,
            version=version(),
            about={**about, "written": today()},
            style=part("style.css"),
            program=program,
            drawing=drawing,
            hashes=" ".join(f"'sha256-{sha256(text)}'" for text in (program, drawing)),
            **content,
        )
    )
