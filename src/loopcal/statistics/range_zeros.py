"""The zero of the distances that an instrument reads: a wrong constant of a prism or reflector.

An instrument at the origin of its frame that reads every distance c too long reads p + c p / |p|
instead of p. Its column in the whitened equations, sum_q (p_q / |p|) C_q of its readings q, stands
beside those of all parameters as that of a scale does (`scales`). A scale grows with the distance
and a shift of the station is alike in all directions, so distances and directions that differ
separate the three.
"""

from __future__ import annotations

import math

import numpy as np

from loopcal.arrays import Array
from loopcal.document.findings import ScaleEntry
from loopcal.estimation.dependence.seen import instruments
from loopcal.mechanisms.effects.station_scales import by_station
from loopcal.mechanisms.mechanism import Family
from loopcal.small_samples import f_tail
from loopcal.statistics.ordered_system import Fitted, OrderedSystem

_READ = {"point": slice(None), "spherical": slice(1), "polar": slice(1)}
"""What reads points from where it stands, and which of its readings a distance changes."""
# As that of a scale: far above rounding.
_ABSORBED = 1e-10


def range_zeros(fit: Fitted) -> tuple[ScaleEntry, ...]:
    """By station the distance that is read too long, with the p-value of one that is not there."""
    seen = {family.name for family in instruments(fit.system.problem)}
    entries = []
    for station in by_station(fit.system.problem.mechanism):
        families = [f for f in station if f.name in seen]
        if not families or any(f.form not in _READ for f in families):
            continue
        column, spread = _column(fit.system, families)
        found = fit.step(column, _ABSORBED)
        if math.isfinite(spread) and found.rank:
            (size,), (sd,) = found.size.tolist(), found.sds.tolist()
            p_value = f_tail(found.before(fit.spare), 1, math.inf)
            names = tuple(f.name for f in families)
            entries.append(ScaleEntry(names, size, sd, p_value, abs(size) * spread, "m"))
    return tuple(entries)


def _column(system: OrderedSystem, families: list[Family]) -> tuple[Array, float]:
    """(N, R, 1) of distances one metre too long, and the rms by which it moves points about their
    mean [m]; infinite where the frame cannot be the instrument's own."""
    problem, total, spread = system.problem, 0.0, 0.0
    for family in families:
        names = list(family.readings[_READ[family.form]])
        rows = [problem.mechanism.tape.quantities.index(q) for q in names]
        read = problem.readings[rows][:, system.order]
        if family.form == "point":
            if _among(read):
                spread = math.inf
            read = read / np.linalg.norm(read, axis=0)
            spread = max(spread, math.sqrt(float(np.nanvar(read, axis=1).sum())))
        else:
            read, spread = np.ones_like(read), max(spread, 1.0)
        total = total + np.einsum("nrq,qn->nr", system.columns(names), np.nan_to_num(read))
    return np.asarray(total)[:, :, None], spread


def _among(points: Array) -> bool:
    """Whether the origin lies among points (c, N), as that of a machine does: instruments stand
    outside its reach."""
    middle = np.nanmean(points, axis=1, keepdims=True)
    away = np.linalg.norm(points - middle, axis=0)
    return bool(np.linalg.norm(middle) <= np.nanmax(away))
