"""Closing loops with given parameters: true values of the quantities that nobody drives.

Newton's method on f(x, p) = 0 with LAPACK, pose by pose in stacks, and on purpose not the
estimator's own elimination: what is simulated here checks what is estimated there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.expressions.domain import explain_domain
from loopcal.expressions.engine import engine_for
from loopcal.mechanisms.mechanism import Mechanism

Array = NDArray[np.float64]
_BLOCK = 4096
_MOST = 50
_STEP, _OPEN = 1e-13, 1e-9
"""Relative to 1 or to the largest value: steps this small are rounding; loops this far open are."""
_TURN = 0.5
"""No angle [rad] is turned by more in one step: beyond that Newton's method leads anywhere. (What
an orientation is off by is no such angle: its loops are linear in it, and it may be large.)"""


def close_loops(
    mechanism: Mechanism,
    parameters: Array,
    values: Array,
    known: Array,
    unknown: Sequence[str],
    poses: Sequence[str],
) -> Array:
    """All quantities (k, N) [SI], those `unknown` changed so that every loop closes.

    parameters: (n_all,); values: (k, N), start values where unknown; known: (c, N); in the orders
    of the tape. Where loops are more than unknowns they must agree.

    Raises InputError (DomainError) naming the first pose whose loops cannot be evaluated or do
    not close, and where loops are too few.
    """
    tape = mechanism.tape
    rows = [tape.quantities.index(name) for name in unknown]
    if len(rows) > len(tape.loops):
        raise _too_few_driven(mechanism, unknown)
    angles = {name for name in unknown if mechanism.quantities[name] == "rad"}
    angles -= {turn for orientation in mechanism.orientations for turn in orientation.turns}
    turns = [i for i, name in enumerate(unknown) if name in angles]
    closed = np.array(values, dtype=float)
    engine = engine_for(tape, (), min(_BLOCK, max(closed.shape[1], 1)))
    engine.at(parameters)
    for begin in range(0, closed.shape[1], _BLOCK):
        part = slice(begin, begin + _BLOCK)
        x, c = closed[:, part], known[:, part]
        for _ in range(_MOST):
            loops = engine.evaluate(x, c)
            if not (np.isfinite(loops.f).all() and np.isfinite(loops.by_quantity).all()):
                raise explain_domain(tape, x, c, parameters, poses[part], mechanism.remedies)
            step = _newton_step(loops.by_quantity[rows], loops.f)
            largest = np.abs(step[turns]).max(axis=0, initial=0.0)
            step *= _TURN / np.maximum(largest, _TURN)
            x[rows] -= step
            if np.abs(step).max(initial=0.0) <= _STEP * max(1.0, np.abs(x).max()):
                break
        _refuse_open(mechanism, engine.evaluate(x, c).f, x, poses[part])
    return closed


def _too_few_driven(mechanism: Mechanism, unknown: Sequence[str]) -> InputError:
    loops = len(mechanism.tape.loops)
    drivable = [name for name in unknown if name not in mechanism.outputs]
    computed = ", ".join(mechanism.outputs)
    return InputError(
        f"{len(unknown)} quantities ({', '.join(unknown)}) cannot be found from {loops} loop "
        "equations",
        code="undetermined-quantities",
        remedy=f"give the values of {len(unknown) - loops} of {', '.join(drivable)} in every pose"
        + (f"; the outputs ({computed}) are computed, not driven" if computed else ""),
    )


def _newton_step(by_unknown: Array, f: Array) -> Array:
    """The step (u, b) of least squares, least in norm where a pose is singular."""
    J = np.ascontiguousarray(by_unknown.transpose(2, 1, 0))
    right = np.ascontiguousarray(f.T)[..., None]
    if J.shape[1] == J.shape[2]:
        try:
            return np.ascontiguousarray(np.linalg.solve(J, right)[..., 0].T)
        except np.linalg.LinAlgError:
            pass
    return np.ascontiguousarray((np.linalg.pinv(J) @ right)[..., 0].T)


def _refuse_open(mechanism: Mechanism, f: Array, x: Array, poses: Sequence[str]) -> None:
    worst = np.abs(f).max(axis=0)
    still_open = ~(worst <= _OPEN * np.maximum(1.0, np.abs(x).max(axis=0)))
    if still_open.any():
        first = int(np.argmax(still_open))
        loop = mechanism.tape.loops[int(np.argmax(np.abs(f[:, first])))]
        raise InputError(
            f"the loops of {int(still_open.sum())} poses cannot close; at pose {poses[first]!r} "
            f"the loop equation {loop!r} stays {worst[first]:.3g} away from zero",
            code="open-loops",
            remedy="keep the mechanism within its reach, or give better start values"
            + ("; leave one quantity undriven per contact" if mechanism.implied else ""),
        )
