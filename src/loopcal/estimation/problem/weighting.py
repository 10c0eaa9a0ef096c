"""What the loops of a pose count in a fit, and where they are linearised for it."""

from __future__ import annotations

from enum import Enum


class Weighting(Enum):
    """CORRECTED: by the sds of the readings, where these are corrected to (maximum likelihood).

    READ: by the same sds, with derivatives by the parameters where the readings stand (reweighted
    least squares). ALIKE: every loop alike and no prior, the readings taken as exact (3.1 to 3.6
    of the thesis).
    """

    CORRECTED = "corrected"
    READ = "read"
    ALIKE = "alike"
