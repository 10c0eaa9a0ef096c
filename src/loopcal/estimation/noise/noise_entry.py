"""The sds that a calibration used, and what it learnt of them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class NoiseEntry:
    """The sd [SI unit] used for one or several quantities; median where it differs by reading.

    source: "given", "reading", "datasheet" or "estimated". Of an estimated one: sd_of_sd, how
    sure it is; upper: 95 % bound, where it is zero or unsure; likelihood_ratio: by how much
    -2 log of the restricted likelihood rises without it (None where the loops need it), p_value:
    of such a rise if there were no such noise.
    """

    quantities: tuple[str, ...]
    unit: str
    sd: float
    sd_of_sd: float | None
    source: str
    upper: float | None = None
    likelihood_ratio: float | None = None
    p_value: float | None = None
