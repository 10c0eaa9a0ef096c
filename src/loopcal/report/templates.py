"""The templates of all pages, and parts that are put into them as they are."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from functools import cache
from typing import TYPE_CHECKING, Any

from loopcal.figures.figure import Figure, plotly_javascript
from loopcal.files.versions import version
from loopcal.presentation.shown import Table, shortened

if TYPE_CHECKING:
    from jinja2 import Environment


# Sections: sentences, then tables and figures. Each can also stand alone as a page.


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


# Words of the report that a reader may want explained where they stand.

GLOSSARY = {
    "rms": "Root mean square: the root of the mean of the squares.",
    "95 %": "95 % of the poses are at most so far off.",
    "sd": "Standard deviation: how uncertain the value is. The true value lies within two sds "
    "with about 95 % probability.",
    "change/sd": "Change from nominal in units of its sd. Below 2 it may be noise.",
    "prior's share": "How much of the value comes from the drawing instead of the data.",
    "nominal": "Computed with the values of the drawing, placed where the instrument sees it.",
    "nominal, best placed": "Computed with the values of the drawing after fitting where the "
    "machine stands and where the target is mounted.",
    "before the update": "Computed with the values of the earlier calibration, where the machine "
    "stands now.",
    "calibrated": "In-sample: on the poses used for the fit. Expect worse on other poses.",
    "on poses not used": "Out-of-sample: predicted by fits that did not use these poses.",
    "in regions not used": "Predicted by fits that used no pose of that region of the joints.",
    "noise floor": "What remains with the right parameters: the noise of the sensors alone.",
    "tolerance": "The distance that 95 % of poses shall keep, from [verdict] of the project.",
    "chi-squared": "Sum of squared corrections over their sds. It should be near the degrees of "
    "freedom.",
    "degrees of freedom": "Number of equations minus number of parameters.",
    "p-value": "Probability of a misfit at least so large if all sds and the model are right.",
    "statistic": "How far the pose is from what the other poses predict, in squared sds.",
    "sd of sd": "How uncertain a learnt sd is.",
    "rms corr./sd": "Rms of the corrections over the sds. A well checked sensor has about 1.",
    "redundancy": "How much of an error of this sensor the other readings reveal.",
    "detectable": "Smallest error of a single reading that the test finds.",
    "factor": "Chi-squared of the sensor over its redundancy. It is 1 where the sd is right.",
    "gain": "In -2 log likelihood. Above 10 the machine model is wrong without this term.",
}
"""Word -> its meaning in one or two sentences."""


def meaning(cell: str) -> str:
    """The meaning of a heading, "" where it has none; a unit in brackets does not matter."""
    return GLOSSARY.get(cell.split(" [")[0], "")
