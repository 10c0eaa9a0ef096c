"""The [verdict] table of a project: tolerance, working region, and what is required."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from loopcal.document.verdict import QUESTIONS
from loopcal.errors import InputError
from loopcal.files.project.names import DRIVEN
from loopcal.keys import CONTEXT, Key, Made

SPAN = {"theta_1": {"from": -90, "to": 90, "unit": "deg"}}


def span(
    from_: Annotated[float, Key("Smallest value.", unit=CONTEXT, beside=True)],
    to: Annotated[float, Key("Largest value.", unit=CONTEXT, beside=True)],
    unit: Annotated[str | None, Key("Of both.", is_unit=True)] = None,
) -> tuple[float, float]:
    """A range, from a number to a larger one."""
    if not from_ < to:
        raise InputError(
            f"the range goes from {from_:g} to {to:g} (SI)",
            code="invalid-value",
            remedy="give the smaller number first",
        )
    return from_, to


Span = Annotated[tuple[float, float], Made(span)]


@dataclass(frozen=True)
class VerdictTable:
    """What the verdict judges, and the answers that are required."""

    tolerance: Annotated[
        float | None,
        Key(
            "Distance that 95 % of poses in the working region shall keep.",
            unit=CONTEXT,
            positive=True,
            example={"value": 0.3, "unit": "mm"},
        ),
    ] = None
    region: Annotated[
        Mapping[str, Span],
        Key(
            "Where the machine works, by reading; default: the ranges of [simulation], else the "
            "joints' limits.",
            names=DRIVEN,
            example=SPAN,
        ),
    ] = field(default_factory=dict)
    require: Annotated[
        tuple[str, ...],
        Key("End with exit code 4 unless these questions are answered yes.", choices=QUESTIONS),
    ] = ()
