"""SI values in the units that people read: millimetres, degrees, microradians; others in short."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

from loopcal.errors import short
from loopcal.units import from_si

SHOWN = {"m": "mm", "rad": "deg", "m/K": "um/K", "rad/K": "urad/K"}
"""Units in which SI values are printed, because drawings and controllers use them."""
FINE = {"m": "um", "rad": "urad", "1": "ppm"}
"""Units in which sds of sensors and learnt scales are printed."""
NONE = "–"
LEAST_P = 1e-6
"""Smaller ones are not told apart."""
ROUNDING = 1e-12
"""Without an sd, so little [m, rad] is what the arithmetic left of zero."""


def unit_shown(unit: str, *, fine: bool = False) -> str:
    """The unit in which values of an SI unit are shown; fine: sds of sensors."""
    return (FINE if fine else SHOWN).get(unit, unit)


def factor(unit: str) -> float:
    """One of the units shown, in SI."""
    return 1.0 / float(from_si(1.0, unit_shown(unit))) if unit in SHOWN else 1.0


def size(value: float | None, unit: str, digits: int = 4, *, fine: bool = False) -> str:
    """An SI value in the unit shown, without that unit."""
    if value is None:
        return NONE
    return significant(in_unit(value, unit, fine=fine), digits)


def with_unit(value: float | None, unit: str, digits: int = 3, *, fine: bool = False) -> str:
    """An SI value in the unit shown, with that unit where it has one."""
    shown = size(value, unit, digits, fine=fine)
    return shown if unit == "1" else f"{shown} {unit_shown(unit, fine=fine)}"


def in_unit(value: float, unit: str, *, fine: bool = False) -> float:
    """An SI value as a number of the unit shown."""
    shown = unit_shown(unit, fine=fine)
    return value if shown == unit else float(from_si(value, shown))


def by_sd(value: float, sd: float | None, unit: str, *, sign: bool = False) -> str:
    """An SI value in the unit shown, to the digits of its sd."""
    if sd is None:
        if unit in FINE and abs(value) < ROUNDING:
            return "0"
        shown = in_unit(value, unit)
        return significant(shown, 3) if sign else rounded_by_sd(shown, math.inf)
    return rounded_by_sd(in_unit(value, unit), in_unit(sd, unit), sign=sign)


def chance(value: float | None) -> str:
    """A probability; below a millionth it says no more than that.

    >>> chance(0.0123), chance(8.8e-256)
    ('0.012', '< 1e-6')
    """
    if value is None:
        return NONE
    return f"{value:.2g}" if value >= LEAST_P else "< 1e-6"


def p_words(value: float | None) -> str:
    """The same, as the p-value of a test in a sentence.

    >>> p_words(0.0123), p_words(8.8e-256)
    ('p = 0.012', 'p < 1e-6')
    """
    shown = chance(value)
    return f"p {shown}" if shown.startswith("<") else f"p = {shown}"


def percent(value: float | None, digits: int = 0) -> str:
    """A share, with so many decimals.

    >>> percent(0.8), percent(0.9283, 1)
    ('80 %', '92.8 %')
    """
    return NONE if value is None else f"{100.0 * value:.{digits}f} %"


def enumerated(names: Sequence[str]) -> str:
    """Names in a sentence.

    >>> enumerated(["x", "y", "z"])
    'x, y and z'
    """
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


# Numbers as they are printed: no more digits than their sd supports.


def significant(value: float, digits: int) -> str:
    """A number with so many significant digits, never in exponent form between 1e-4 and 1e9.

    >>> significant(0.0735123, 3), significant(1234567.0, 3), significant(2.0e-7, 2)
    ('0.0735', '1234567', '2.0e-07')
    """
    if value == 0.0 or not math.isfinite(value):
        return "0" if value == 0.0 else str(value)
    magnitude = math.floor(math.log10(abs(value)))
    if not -5 < magnitude < 9:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{max(digits - 1 - magnitude, 0)}f}"


def rounded_by_sd(value: float, sd: float, *, sign: bool = False) -> str:
    """A value to the second significant digit of its sd, without the sign of a rounded zero.

    Without an sd that is finite and positive, nine significant digits.

    >>> rounded_by_sd(614.87123, 0.0213), rounded_by_sd(0.871, 0.0213, sign=True)
    ('614.871', '+0.871')
    >>> rounded_by_sd(-0.0004, 0.0213), rounded_by_sd(450.0, math.inf)
    ('0.000', '450')
    """
    form = "+z" if sign else "z"
    if not (math.isfinite(sd) and sd > 0.0):
        return f"{value:{form}.9g}"
    decimals = 1 - math.floor(math.log10(sd))
    if decimals > 12:
        return f"{value:{form}.12g}"
    return f"{value:{form}.{max(decimals, 0)}f}"


# Long sentences as lines of a width that terminals show.

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


# Tables, and their lines of text.


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


def brief(value: Any) -> str:
    """A dataclass whose numbers are too many to print, `<Kind: the names of its fields>`, as its
    `__repr__`."""
    names = ", ".join(field.name for field in fields(value))
    return f"<{type(value).__name__}: {short(names, 200)}>"
