"""The [plan] table of a project: among which poses `loopcal plan` chooses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from loopcal.document.verdict import QUESTIONS
from loopcal.errors import InputError
from loopcal.files.project.names import DRIVEN, RANGED
from loopcal.keys import CONTEXT, Key, Made
from loopcal.measurements.plan_settings import MODEL_ERRORS, Box, PlanSettings, Sight
from loopcal.mechanisms.limits import joint_limits
from loopcal.mechanisms.mechanism import Mechanism

# The [verdict] table of a project: tolerance, working region, and what is required.

SPAN = {"theta_1": {"from": -90, "to": 90, "unit": "deg"}}


def span(
    from_: Annotated[float, Key("Smallest value.", unit=CONTEXT, beside=True)],
    to: Annotated[float, Key("Largest value.", unit=CONTEXT, beside=True)],
    unit: Annotated[str | None, Key("Of both.", is_unit=True)] = None,
) -> tuple[float, float]:
    """A range, from a number to a larger one."""
    if not from_ < to:
        raise reversed_range(from_, to)
    return from_, to


def reversed_range(low: float, high: float) -> InputError:
    """The error for a range whose ends [SI] are not in order."""
    return InputError(
        f"the range goes from {low:g} to {high:g} (SI)",
        code="invalid-value",
        remedy="give the smaller number first",
    )


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


Side = Annotated[Span | None, Key("Range of this coordinate.", unit="m")]


def box(x: Side = None, y: Side = None, z: Side = None) -> Box:
    """A box in the frame of the machine's base; a coordinate that is absent is not limited."""
    sides = [(-math.inf, math.inf) if side is None else side for side in (x, y, z)]
    return Box(tuple(s[0] for s in sides), tuple(s[1] for s in sides))


def sight(
    station: Annotated[
        tuple[float, ...],
        Key("Place of the instrument in the frame of its readings.", unit="m", beside=True),
    ] = (0.0, 0.0, 0.0),
    unit: Annotated[str | None, Key("Of the station.", is_unit=True)] = None,
    normal: Annotated[
        tuple[float, ...] | None,
        Key("Direction in the body's frame that the reflector looks along.", example=[0, 0, 1]),
    ] = None,
    within: Annotated[
        float | None,
        Key(
            "Largest angle between that direction and the line to the instrument; default: 30 "
            "degrees.",
            unit="rad",
            example={"value": 30, "unit": "deg"},
        ),
    ] = None,
) -> Sight:
    """What the instrument can see."""
    for key, vector in (("station", station), ("normal", normal)):
        if vector is not None and len(vector) != 3:
            raise InputError(
                f"{key} has {len(vector)} numbers",
                code="wrong-shape",
                remedy="give three numbers: x, y, z",
            )
    if normal is not None and not any(normal):
        raise InputError(
            "the normal is 0, which is no direction",
            code="invalid-value",
            remedy="give the direction that the reflector looks along, such as [0, 0, 1]",
        )
    return Sight(station, normal) if within is None else Sight(station, normal, within)


BoxTable = Annotated[Box, Made(box)]


@dataclass(frozen=True)
class PlanTable:
    """Where `loopcal plan` may choose poses."""

    candidates: Annotated[int, Key("How many random poses to choose among.", low=1)] = 3000
    seed: Annotated[int, Key("Of the random poses.", low=0)] = 0
    ranges: Annotated[
        Mapping[str, Span],
        Key(
            "Of each driven quantity and known constant; default: the joints' limits, else "
            "`verdict.region` or the ranges of [simulation].",
            names=RANGED,
            example=SPAN,
        ),
    ] = field(default_factory=dict)
    reach: Annotated[BoxTable | None, Key("Where the end point must be.")] = None
    keep_out: Annotated[
        tuple[BoxTable, ...],
        Key(
            "Boxes that neither the end point, nor the links of a serial arm, nor the line of "
            "sight may touch."
        ),
    ] = ()
    sight: Annotated[
        Annotated[Sight, Made(sight)] | None,
        Key("Line of sight and incidence at the reflector."),
    ] = None
    forbidden: Annotated[
        str | None,
        Key(
            "File of readings, in the columns of [data], near which (1 degree, 1 mm) no pose may "
            "be."
        ),
    ] = None
    model_error: Annotated[
        str,
        Key(
            "structured: choose poses that also show what geometry does not explain.",
            choices=MODEL_ERRORS,
        ),
    ] = "structured"
    repeats: Annotated[
        bool,
        Key(
            "Whether the first pose is measured again in the middle and at the end, which shows a "
            "drift; of plans of 10 poses or more."
        ),
    ] = True

    def settings(
        self, mechanism: Mechanism, region: Mapping[str, tuple[float, float]]
    ) -> PlanSettings:
        """As `plan` takes them; the end point counts in the working region."""
        limits = joint_limits(mechanism)
        elsewhere = {q: r for q, r in region.items() if q not in {*self.ranges, *limits}}
        return PlanSettings(
            {**self.ranges, **elsewhere},
            region,
            self.reach,
            self.keep_out,
            self.sight,
            number=self.candidates,
            model_error=self.model_error,
            seed=self.seed,
            repeats=self.repeats,
        )
