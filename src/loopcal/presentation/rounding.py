"""Numbers as they are printed: no more digits than their sd supports."""

from __future__ import annotations

import math


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
