"""The nominal machine, placed and mounted as well as can be: what a calibration must beat.

Only where machine and instruments stand, and where targets and tools sit on the body, is estimated;
all dimensions stay the drawing's. What is mounted is known to some millimetres: left free it would
run away to make up for a wrong machine, and the comparison would flatter the drawing.
"""

from __future__ import annotations

import math

from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.structure.structured import MOUNTED, unstated_mountings


def nominal_machine(mechanism: Mechanism) -> Mechanism:
    """The mechanism with all fixed but placements and mountings; these get default priors."""
    kinds = mechanism.kinds
    unknown = {name for names in unstated_mountings(mechanism) for name in names}
    fixed = [p.name for p in mechanism.parameters if kinds[p.name] not in ("placement", "mounting")]
    priors = {
        p.name: MOUNTED[p.unit]
        for p in mechanism.parameters
        if kinds[p.name] == "mounting" and math.isinf(p.prior_sd) and p.name not in unknown
    }
    parameters = mechanism.parameters.with_prior(priors).with_fixed(fixed)
    return mechanism.with_parameters(parameters)
