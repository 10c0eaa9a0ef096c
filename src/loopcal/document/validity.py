"""What the value of a parameter rests on."""

from __future__ import annotations

from typing import Literal

from loopcal.document.fit import ParameterEntry

Validity = Literal["determined", "prior", "undetermined", "fixed"]
# 1 / sd^2 = 4 / prior_sd^2: beyond it the prior is more than a quarter of what is known.
MOSTLY_PRIOR = 0.5
"""Sd over prior sd above which a parameter rests on what was known before."""


def validity(entry: ParameterEntry) -> Validity:
    """What the value of a parameter rests on: the data, mostly the prior, nothing, or a choice."""
    if entry.fixed:
        return "fixed"
    if entry.sd is None or not entry.identifiable:
        return "undetermined"
    if entry.prior_sd and entry.sd > MOSTLY_PRIOR * entry.prior_sd:
        return "prior"
    return "determined"
