"""What an arm weighs: known masses of its links, and what its tool carries in each pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from loopcal.errors import InputError
from loopcal.expressions.rewriting import substituted
from loopcal.mechanisms.effects.gravity import Load, end_of, refuse_beyond
from loopcal.mechanisms.machine import ENDS
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.quantity import Quantity


def with_masses(mechanism: Mechanism, masses: Sequence[Load]) -> Mechanism:
    """The arm with these masses of its links, in place of known ones of the same names.

    Raises InputError for a load without mass, beside the arm, or of a joint that it has not.
    """
    steps = mechanism.tree.steps if mechanism.tree else ()
    for load in masses:
        if load.mass is None:
            raise InputError(
                f"{load.name!r} has no mass",
                code="missing-key",
                remedy="give its mass, or leave it out: unknown weights are estimated as sag",
            )
        end_of(steps, load)
        refuse_beyond(steps, mechanism.parameters, load)
    every = tuple({load.name: load for load in (*mechanism.masses, *masses)}.values())
    described = mechanism.description and {**mechanism.description, "mass": list(every)}
    return replace(mechanism, masses=every, description=described)


def in_space(mechanism: Mechanism) -> bool:
    """Whether it is an arm in space, which gives way under what it carries."""
    return bool(mechanism.chain) and mechanism.body is not None and not mechanism.body.planar


def with_payload(mechanism: Mechanism, payload: str) -> Mechanism:
    """The arm whose tool carries a mass that is read in each pose, as a known constant [kg].

    Raises InputError for a machine that is not an arm, and for a name that is taken.
    """
    if not in_space(mechanism):
        raise InputError(
            f"{mechanism.name!r} is no arm in space, so nothing says what its load does",
            code="unsupported",
            remedy="leave payload out",
        )
    taken = {*mechanism.quantities, *mechanism.pose_constants, *mechanism.parameters.names}
    if payload in taken:
        raise InputError(
            f"the payload {payload!r} has the name of another quantity or parameter",
            code="duplicate-name",
            remedy="give its column another name",
        )
    ends = ENDS if any(v.first for v in mechanism.variables) else ENDS[:1]
    constants = [Quantity(payload + end, "kg", "known", payload if end else None) for end in ends]
    names = [constant.name for constant in constants]
    carrying = mechanism.with_tape(
        lambda tape: substituted(tape, lambda x, p: ({}, {}), pose_constants=names)
    )
    described = mechanism.description and {**mechanism.description, "payload": payload}
    variables = (*mechanism.variables, *constants)
    return replace(carrying, variables=variables, payload=payload, description=described)
