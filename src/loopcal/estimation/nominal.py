"""The nominal machine, placed and mounted as well as can be: what a calibration must beat.

Only where machine and instruments stand, and where targets and tools sit on the body, is estimated;
all dimensions stay the drawing's. What is mounted is known to some millimetres: left free it would
run away to make up for a wrong machine, and the comparison would flatter the drawing.
"""

from __future__ import annotations

import math
from collections.abc import Collection

from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.structure.structured import MOUNTED, unstated_mountings


def nominal_machine(mechanism: Mechanism, moved: Collection[str] = ()) -> Mechanism:
    """The mechanism with all fixed but placements and mountings; these get default priors.

    moved: parameters of what slipped during the run, which is no fault of the drawing's.
    """
    kinds = mechanism.kinds
    unknown = {name for names in unstated_mountings(mechanism) for name in names}
    placed = {name for name, kind in kinds.items() if kind in ("placement", "mounting")} | {*moved}
    fixed = [p.name for p in mechanism.parameters if p.name not in placed]
    priors = {
        p.name: MOUNTED[p.unit]
        for p in mechanism.parameters
        if kinds[p.name] == "mounting" and math.isinf(p.prior_sd) and p.name not in unknown
    }
    parameters = mechanism.parameters.with_prior(priors).with_fixed(fixed)
    return mechanism.with_parameters(parameters)
