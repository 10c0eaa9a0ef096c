"""Whether anything says how large the machine is.

A ball in its socket, a probe on a plane and joints that turn fit a machine of any size: multiply
all its lengths by one factor, and every gap that is 0 stays 0. Worse, the smaller the machine,
the less its joints' noise moves the ball, so a fit would shrink it without end.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.mechanisms.mechanism import Mechanism

Array = NDArray[np.float64]
_NOISE = 6.0
"""So many sds away from 0 a reading is no noise."""


def refuse_without_length(mechanism: Mechanism, readings: Array, sd: Array) -> None:
    """InputError where the only lengths read are gaps of 0, and none is held or known beforehand.

    readings: (k, N); sd: (k, N) or (k, 1), both [SI] in the order of the quantities. A gap within
    its noise of 0 says no more than one of 0.
    """
    names, units = mechanism.tape.quantities, mechanism.quantities
    read = np.flatnonzero(np.any(np.isfinite(sd), axis=1)).tolist()
    lengths = [i for i in read if units[names[i]] == "m"]
    gaps = {names[i] for i in lengths}
    if not gaps or not gaps <= set(mechanism.implied):
        return
    if (np.abs(readings[lengths]) > _NOISE * sd[lengths]).any():
        return
    own = [p for p in mechanism.parameters if p.unit == "m" and p.nominal]
    if not own or any(p.fixed or math.isfinite(p.prior_sd) for p in own):
        return
    seen = tuple(f"{family.name}_" for family in mechanism.families)
    links = [p for p in own if not p.name.startswith(seen)] or own
    longest = max(links, key=lambda p: abs(p.nominal)).name
    listed = ", ".join(names[i] for i in lengths)
    raise InputError(
        f"no length is measured: by construction 0 is read of {listed}, and would be of a machine "
        "of any size",
        remedy=f"hold a length that is known, say {longest} = {{ fixed = true }} under "
        "[parameters], or give it a prior sd; or measure one, with a ball-bar of known length or "
        "as the distance of two poses",
    )
