"""How well a set of poses shows the parameters, in the five numbers of the literature.

They are taken from the singular values sigma of the whitened parameter Jacobian of all poses, each
column divided by its length: numbers without a unit, which do not depend on the units of the
parameters, on how large all sds are together, nor on how the loop equations are written. Prior
knowledge is left out; they speak of the poses alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from loopcal.document.findings import Observability
from loopcal.estimation.solve.reduction import Accumulator, Spectrum, spectrum

Array = NDArray[np.float64]


def data_spectrum(information: Accumulator) -> Spectrum:
    """The spectrum of what the data alone say, columns scaled to length 1."""
    n = len(information.total) - 1
    return spectrum(information, np.zeros(n), np.full(n, np.inf))


def observability(information: Accumulator, poses: int) -> Observability:
    """The indices of the poses whose whitened equations were added up."""
    system = data_spectrum(information)
    s = np.where(system.kept, system.singular_values, 0.0)
    if not s.all():
        return Observability(0.0, 0.0, 0.0, 0.0, 0.0)
    low, high = float(s.min()), float(s.max())
    return Observability(
        # By logarithms: the product of many small values would underflow.
        O1=float(np.exp(np.log(s).mean())) / float(np.sqrt(poses)),
        O2=low / high,
        O3=low,
        O4=low**2 / high,
        O5=1.0 / float((1.0 / s).sum()),
    )
