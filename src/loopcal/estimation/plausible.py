"""Values stated in a unit that they cannot be in: lengths and angles of a machine, sds of readings.

A machine is about as large as what is measured of it, and a sensor whose sd is half of all that it
ever reads says nothing. What breaks these rules is by all experience in another unit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from loopcal.errors import Code, InputError, listed
from loopcal.estimation.fit import Fit
from loopcal.estimation.methods.registry import names_where
from loopcal.estimation.problem.problem import Problem, Weighting
from loopcal.estimation.problem.starting import start_corrections
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.solver import solve
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import MODEL, Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.presentation.shown import significant, with_unit

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


# Readings stated as exact (sd 0) that contradict each other: loops that nothing may close.

CODE: Final[Code] = "exact-readings"
"""Of the error that names them."""


def refuse_contradiction(problem: Problem, data: Dataset) -> None:
    """Raise InputError where some loop has no reading with an sd above 0 that could close it.

    It names the readings stated as exact, and by how much the best fit misses them: by a
    method that weighs all loops alike.
    """
    exact = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape) == 0.0
    if not exact.any():
        return
    sweeper = Sweeper(problem)
    failed = sweeper.singular(problem.start, start_corrections(sweeper, problem.start))
    if not failed:
        return
    tape = problem.mechanism.tape
    rows = [tape.quantities.index(q) for q in tape.quantities if q not in problem.mechanism.implied]
    names = [tape.quantities[i] for i in rows if exact[i].any()]
    poses = f"{failed.count} poses" if failed.count > 1 else "1 pose"
    raise InputError(
        f"{listed(names)} are stated as exact (sd 0), but the loops of {poses} cannot close, first "
        f"at pose {failed.poses[0]!r}: {_misfit(problem, data)}",
        code=CODE,
        remedy="state an sd above 0 for a reading of every loop equation, or leave out the sds and "
        f"use the method {' or '.join(names_where('exact'))}",
    )


def _misfit(problem: Problem, data: Dataset) -> str:
    """How far the best fit is from the readings, in words."""
    fit = Fit(method=names_where("exact")[0])
    alike = problem.weighted(Weighting.ALIKE)
    best = FitResult(fit, data, alike, solve(alike), alike)
    apart = best.accuracy_after
    if apart is not None:
        size = with_unit(apart.rms, apart.unit)
        return f"the best fit misses the measured outputs by {size} rms"
    return f"the best fit leaves loop values of {significant(best.closure_after.rms, 2)} rms"
