"""A parallel machine in one pose as lines, its platform found from what is read."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from loopcal.expressions.engine import Stage, engine_for
from loopcal.mechanisms.machine import Machine
from loopcal.mechanisms.mechanism import Mechanism

Array = NDArray[np.float64]
_MOST, _SETTLED, _OPEN = 50, 1e-10, 0.05


def parallel_lines(
    mechanism: Mechanism, machine: Machine, readings: Mapping[str, float]
) -> list[Array] | None:
    """Lines (k, 3) [m] in the machine's base; None where the platform is not found.

    readings: [m, rad] of one pose, as far as there are any.
    """
    x = _located(mechanism, readings)
    if machine.lines is None or x is None:
        return None
    values = {p.name: p.nominal for p in mechanism.parameters}
    return [np.array(line, dtype=float) for line in machine.lines(x, values)]


def _located(mechanism: Mechanism, readings: Mapping[str, float]) -> dict[str, float] | None:
    """Readings, and what was not read of the machine, from home by Gauss and Newton's method."""
    tape = mechanism.tape
    x = {**dict.fromkeys(tape.quantities, np.nan), **mechanism.home, **readings}
    unread = tuple(q for q in mechanism.home if q not in readings)
    engine = engine_for(tape, (), 64, unread)
    engine.at(np.array([p.nominal for p in mechanism.parameters]))
    known = np.full((len(tape.known), 1), np.nan)
    step, f = np.zeros(0), np.zeros(0)
    for _ in range(_MOST):
        at = np.array([[x[q]] for q in tape.quantities])
        values = engine.evaluate(at, known, Stage.BY_QUANTITY)
        told = np.isfinite(values.f[:, 0])  # loops with readings that are not there say nothing
        f = values.f[told, 0].copy()
        J = values.by_quantity[:, told, 0].T
        if not np.isfinite(J).all() or len(f) < len(unread):
            return None
        step = np.linalg.lstsq(J, -f)[0]
        x |= {q: x[q] + float(change) for q, change in zip(unread, step, strict=True)}
        if np.abs(step).max(initial=0.0) <= _SETTLED:
            break
    return x if np.abs(f).max(initial=0.0) <= _OPEN else None
