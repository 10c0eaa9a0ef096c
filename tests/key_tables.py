"""Tables of the reference, made of the declarations that they describe.

A page holds `<!-- keys: NAME -->`, the table and `<!-- end -->`; see `tests/documented_rows.py`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import is_dataclass
from typing import Any

from loopcal.keys import REQUIRED, Argument, arguments, plain
from tests.documented_rows import DOCS, check_block, markdown

REFERENCE = DOCS / "reference"


def shown(default: Any) -> str:
    """A default as a file states it; None is told by the key's own words."""
    if default is REQUIRED:
        return "required"
    value = "" if is_dataclass(default) else plain(default)
    if value is None or value in ({}, ""):
        return ""
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return f"`{text}`".replace("'", '"')


def choices(argument: Argument) -> str:
    """What a key may be, where that is listed; the only schema needs no list."""
    among = argument.key.choices
    quoted = (f'`"{c}"`' if isinstance(c, str) else f"`{c}`" for c in among)
    return f" One of {', '.join(quoted)}." if len(among) > 1 else ""


def table(make: Callable[..., Any], common: Callable[..., Any] | None = None) -> str:
    """The table of what a maker's keys say, without those that another table lists for several."""
    elsewhere = () if common is None else {a.name for a in arguments(common)}
    rows = [
        (f"`{a.written}`", shown(a.default), a.key.says.replace("|", "/") + choices(a))
        for a in arguments(make)
        if a.name not in elsewhere
    ]
    return markdown(("key", "default", "says"), rows)


def named(page: str) -> list[str]:
    """The names of the tables of a page."""
    return re.findall(r"<!-- keys: (\S+) -->", (REFERENCE / page).read_text("utf-8"))


def assert_stated(
    page: str, name: str, make: Callable[..., Any], common: Callable[..., Any] | None = None
) -> None:
    """The page has one table of that name, and it is the one that the declaration gives."""
    check_block(f"reference/{page}", f"keys: {name}", table(make, common))
