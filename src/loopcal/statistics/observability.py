"""How well a set of poses shows the parameters, in the five numbers of the literature.

They are taken from the singular values sigma of the whitened parameter Jacobian of all poses, each
column divided by its length: numbers without a unit, which do not depend on the units of the
parameters, on how large all sds are together, nor on how the loop equations are written. Prior
knowledge is left out; they speak of the poses alone.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.solve.reduction import Accumulator, Spectrum, spectrum
from loopcal.presentation.rounding import significant

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Observability:
    """The observability indices of a set of poses, without unit; larger is better.

    sigma_1 >= ... >= sigma_n are the singular values of the column-scaled, whitened Jacobian of
    N poses. Columns have the length 1, so that sigma_1^2 + ... + sigma_n^2 = n whatever N is; N
    enters O1 alone, which therefore compares sets of equally many poses only. All are zero where
    a direction is not determined.
    """

    O1: float
    """(sigma_1 ... sigma_n)^(1/n) / sqrt(N). Borm and Menq (1991)."""
    O2: float
    """sigma_n / sigma_1, the inverse condition number. Driels and Pathre (1990)."""
    O3: float
    """sigma_n. Nahvi, Hollerbach and Hayward (1994)."""
    O4: float
    """sigma_n^2 / sigma_1. Nahvi and Hollerbach (1996)."""
    O5: float
    """1 / (1/sigma_1 + ... + 1/sigma_n). Sun and Hollerbach (2008)."""

    def document(self) -> dict[str, float]:
        """As result.json holds it."""
        return asdict(self)

    def words(self) -> str:
        """One line."""
        numbers = ", ".join(f"{k} {significant(v, 3)}" for k, v in self.document().items())
        return f"observability {numbers}"


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
        O1=float(np.exp(np.log(s).mean())) / float(np.sqrt(poses)),
        O2=low / high,
        O3=low,
        O4=low**2 / high,
        O5=1.0 / float((1.0 / s).sum()),
    )
