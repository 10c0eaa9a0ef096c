"""Parallel axes in Denavit and Hartenberg's parameters, whose estimation has no solution.

The common normal of two parallel axes lies anywhere along them. If the second one is misaligned by
little, d, a, alpha and offset jump to values far from the nominal ones: a fit runs away or stalls.
Hayati and Mirmirani (1985) therefore give such a joint a second angle, beta, in place of d.
"""

from __future__ import annotations

import math
from itertools import pairwise

from loopcal.errors import InputError
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter
from loopcal.mechanisms.serial import Joint, parameter_name

_PARALLEL = 1e-3
"""Axes at a smaller angle [rad] or sine are parallel, as misaligned as robots are made."""
# Chosen, not derived: along parallel axes a wider prior leaves d to the rounding of their angle.
_WEAK = 0.1
"""A prior of d holds a joint only if its sd is at most this share of the largest length."""


def refuse_parallel_axes(mechanism: Mechanism) -> None:
    """Raise InputError for parallel consecutive axes between which d, d and alpha are free.

    Only of revolute joints that follow each other without fixed motions, both "dh" or both "mdh".
    """
    by_name = {p.name: p for p in mechanism.parameters}
    size = max((abs(p.nominal) for p in by_name.values() if p.unit == "m"), default=0.0)
    joints = (mechanism.description or {}).get("joints", [])
    for number, (one, two) in enumerate(pairwise(joints), 1):
        if not (isinstance(one, Joint) and isinstance(two, Joint)) or one.after or two.before:
            continue
        if one.form != two.form or one.form not in ("dh", "mdh"):
            continue
        if "prismatic" in (one.kind, two.kind):
            continue
        # "mdh" turns by alpha before its joint: the alpha between the two is that of the second.
        between = number if one.form == "dh" else number + 1
        alpha = by_name.get(parameter_name(one.form, "alpha", between))
        slides = [by_name.get(parameter_name(one.form, "d", i)) for i in (number, number + 1)]
        if alpha is None or alpha.fixed or abs(math.sin(alpha.nominal)) > _PARALLEL:
            continue
        if all(d is not None and _is_free(d, _WEAK * size) for d in slides):
            raise _parallel(one, two, number)


def _is_free(parameter: Parameter, weak: float) -> bool:
    return not parameter.fixed and parameter.prior_sd > weak


def _parallel(one: Joint, two: Joint, number: int) -> InputError:
    names = [parameter_name(one.form, "d", i) for i in (number, number + 1)]
    remedy = f'give joint {one.name!r} the form = "hayati"'
    if one.form == "mdh":
        remedy = f'describe the arm by form = "dh", and joint {one.name!r} by form = "hayati"'
    return InputError(
        f"the axes of joints {one.name!r} and {two.name!r} are parallel, and {names[0]!r} and "
        f"{names[1]!r} are both free: no readings can determine where their common normal lies",
        code="not-identifiable",
        remedy=f"{remedy}, or fix one of the two, or give them a prior sd of a few mm",
    )
