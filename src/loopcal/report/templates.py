"""The templates of all pages, and parts that are put into them as they are."""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from typing import TYPE_CHECKING

from loopcal.presentation.wrapped import shortened
from loopcal.report.glossary import meaning

if TYPE_CHECKING:
    from jinja2 import Environment


def sha256(text: str) -> str:
    """For a content security policy."""
    return base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")


@cache
def environment() -> Environment:
    """The templates of this package; whatever is put into them is escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader("loopcal.report", "template"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.globals |= {"meaning": meaning, "shortened": shortened}
    return made


def part(name: str) -> str:
    """The text of a part that is no template."""
    templates = environment()
    assert templates.loader is not None
    return templates.loader.get_source(templates, name)[0]
