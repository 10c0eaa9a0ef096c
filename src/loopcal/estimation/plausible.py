"""Values stated in a unit that they cannot be in: lengths and angles of a machine, sds of readings.

A machine is about as large as what is measured of it, and a sensor whose sd is half of all that it
ever reads says nothing. What breaks these rules is by all experience in another unit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from loopcal.errors import InputError
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import MODEL, Noise
from loopcal.mechanisms.mechanism import Mechanism

# This, TURNS and HALF: docs/decisions/0052.
LONG, TIMES = 10.0, 20.0
"""A length [m] beyond this that is so many times the longest reading of a length."""
TURNS = 4.0 * math.pi
"""An angle [rad] beyond this, where no reading of an angle is."""
COARSE, HALF, SIXTH = 0.1, 0.5, 1.0 / 6.0
"""An sd [m or rad] beyond the first, that is so large a share of the spread of its readings, and of
their rms: repeated readings of one length spread little."""
_LIKELY = {"m": "mm", "rad": "deg"}
_LEAST = {"m": LONG, "rad": TURNS}
"""Values up to these are in order whatever was read."""
_FINER = {"m": "mm", "rad": "mrad"}


def refuse_other_units(mechanism: Mechanism, dataset: Dataset, noise: Noise | None) -> None:
    """Raise InputError, with the likely unit, for a nominal value or an sd in another unit."""
    for parameter in mechanism.parameters:
        size, si = abs(parameter.nominal), parameter.unit
        if si not in _LEAST or size <= _LEAST[si]:
            continue
        read = _largest(mechanism, dataset, si)
        if read is None:
            continue
        far = size > max(LONG, TIMES * read) if si == "m" else size > TURNS >= read
        if far:
            raise InputError(
                f"the nominal value of {parameter.name!r} is {parameter.nominal:g} {si}, and no "
                f"reading exceeds {read:.3g} {si}: it looks like {_LIKELY[si]}",
                code="implausible-unit",
                place=mechanism.name,
                remedy=f"state the value in {si}, or its unit: {_LIKELY[si]}",
            )
    for name, sd in _scalar_sds(mechanism, noise):
        si, values = mechanism.quantities[name], dataset.readings.get(name)
        if si not in _FINER or values is None or not COARSE <= sd < math.inf:
            continue
        if not np.isfinite(values).any():
            continue
        spread = float(np.nanstd(values))
        rms = float(np.sqrt(np.nanmean(np.square(values))))
        if sd >= max(HALF * spread, SIXTH * rms):
            raise InputError(
                f"the sd of {name!r} is {sd:g} {si}, and its readings spread by {spread:.3g} {si}: "
                f"the sd looks like {_FINER[si]}",
                code="implausible-unit",
                place=dataset.source.name,
                remedy=f"state the sd in {si}, or its unit; inf if {name!r} is not measured",
            )


def _largest(mechanism: Mechanism, dataset: Dataset, si: str) -> float | None:
    """The largest reading of this unit; None where nothing is read in it."""
    names = [q for q, u in mechanism.quantities.items() if u == si and q in dataset.readings]
    sizes = [np.abs(dataset.readings[q]) for q in names]
    maxima = [float(np.nanmax(s)) for s in sizes if np.isfinite(s).any()]
    return max(maxima, default=None)


def _scalar_sds(mechanism: Mechanism, noise: Noise | None) -> Iterator[tuple[str, float]]:
    """The sds that are stated as one number and not learnt; later entries win."""
    sds: dict[str, float] = {}
    if noise is None:
        return
    for key, value in noise.entries.items():
        for name in () if isinstance(key, tuple) or key == MODEL else mechanism.quantity_group(key):
            sds.pop(name, None)
            if isinstance(value, int | float | np.ndarray) and np.ndim(value) == 0:
                sds[name] = float(value)
    for key in noise.estimate:
        for part in key if isinstance(key, tuple) else (key,):
            for name in () if part == MODEL else mechanism.quantity_group(part):
                sds.pop(name, None)
    yield from sds.items()
