"""The nominal machine, placed and mounted as well as can be: what a calibration must beat.

Only where machine and instruments stand, and where targets and tools sit on the body, is estimated;
all dimensions stay the drawing's. What is mounted is known to some millimetres: left free it would
run away to make up for a wrong machine, and the comparison would flatter the drawing.
"""

from __future__ import annotations

from collections.abc import Collection

from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.structure.structured import mounted


def nominal_machine(mechanism: Mechanism, moved: Collection[str] = ()) -> Mechanism:
    """The mechanism with all fixed but placements and mountings; these get default priors.

    moved: parameters of what slipped during the run, which is no fault of the drawing's.
    """
    placed = {*mechanism.parameters.of_role("placement", "mounting"), *moved}
    fixed = [p.name for p in mechanism.parameters if p.name not in placed]
    made = mounted(mechanism)
    return made.with_parameters(made.parameters.with_fixed(fixed))
