"""Long sentences as lines of a width that terminals show."""

from __future__ import annotations

import textwrap

WIDTH = 100
"""Characters of a line of text in a summary; tables may be wider."""
SHORT = 170
"""Characters of a headline; the finding behind it is told in full below."""


def wrapped(text: str, first: str = "", then: str = "") -> list[str]:
    """Lines of at most `WIDTH` characters; first and then: what the first line and the others
    begin with.

    >>> wrapped("a " * 60 + "b", "* ", "  ")[1]
    '  a a a a a a a a a a a b'
    """
    return textwrap.wrap(
        text,
        WIDTH,
        initial_indent=first,
        subsequent_indent=then,
        break_long_words=False,
        break_on_hyphens=False,
    ) or [first.rstrip()]


def shortened(text: str, most: int = SHORT) -> str:
    """A text cut between words where it is longer."""
    return text if len(text) <= most else text[:most].rsplit(" ", 1)[0].rstrip(" ;,:") + " …"
