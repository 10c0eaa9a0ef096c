"""Instruments that read one length: distances to a fixed point, draw-wires, between two poses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from loopcal.expressions.vectors import norm
from loopcal.keys import Key
from loopcal.mechanisms.frame import Frame, Values
from loopcal.mechanisms.machine import Instrument, recorded
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.station import Anchor, LookedAt, Name, Reading, Target


@recorded
def distance(
    name: Name = "distance",
    *,
    reading: Reading = None,
    anchor: Anchor = None,
    target: LookedAt = "tool",
    offset: Annotated[bool, Key("Whether NAME_offset is estimated.")] = False,
    dimension: int = 3,
) -> Instrument:
    """The distance of a target from a point A fixed in the machine's base.

    Loop: |T_base_body p_target - A| + offset - reading = 0 [m]. reading: its name, by default
    that of the instrument; anchor: name of A (default: that of the instrument), whose coordinates
    are the parameters ANCHOR_x, _y, _z and need nominal values; target: as for `point`; offset:
    whether NAME_offset is estimated, what the reading is too long by.
    """
    reading_name = reading or name
    fixed = Target.named(anchor or name, dimension)
    looked_at = Target.of(target, dimension)
    zero = {f"{name}_offset": Parameter(f"{name}_offset", 0.0, "m")} if offset else {}

    def equations(frames: Sequence[Frame], x: Values, p: Values) -> list[Any]:
        length = norm(frames[0].point(looked_at.point(p)) - fixed.point(p))
        for parameter in zero:
            length = length + p[parameter]
        return [length - x[reading_name]]

    return Instrument(
        name,
        {reading_name: "m"},
        looked_at.declared | zero,
        equations,
        "length",
        placement=fixed.declared,
        mounted=looked_at.parameters,
        dimension=dimension,
        remedy=apart(fixed),
    )


@recorded
def draw_wire(
    name: Name = "wire",
    *,
    reading: Reading = None,
    anchor: Anchor = None,
    target: LookedAt = "tool",
    dimension: int = 3,
) -> Instrument:
    """A wire drawn from a fixed point A to a target: a `distance` whose zero is unknown.

    Loop: |T_base_body p_target - A| + NAME_offset - reading = 0 [m]; arguments as for `distance`.
    """
    return distance(
        name, reading=reading, anchor=anchor, target=target, offset=True, dimension=dimension
    )


@recorded
def relative_distance(
    name: Name = "span",
    *,
    reading: Reading = None,
    target: LookedAt = "tool",
    dimension: int = 3,
) -> Instrument:
    """The distance of a target in one pose from itself in another, wherever the machine stands.

    Loop: |T_base_body(a) p_target - T_base_body(b) p_target| - reading = 0 [m]. A row of data
    holds both poses: the machine's quantities, and once more with "_b" appended.
    """
    reading_name = reading or name
    looked_at = Target.of(target, dimension)

    def equations(frames: Sequence[Frame], x: Values, p: Values) -> list[Any]:
        a, b = (frame.point(looked_at.point(p)) for frame in frames)
        return [norm(a - b) - x[reading_name]]

    return Instrument(
        name,
        {reading_name: "m"},
        looked_at.declared,
        equations,
        "length",
        mounted=looked_at.parameters,
        ends=2,
        dimension=dimension,
        remedy="give rows of two poses in which the target is at different places",
    )


def apart(anchor: Target) -> str:
    """What to do where a distance from a point is taken at the point itself."""
    return (
        f"the target is at the point {', '.join(anchor.parameters)} itself, where no direction "
        "leads to it: give that point the nominal place where it was mounted (0.3 m off will do), "
        "and leave out poses that reach it"
    )
