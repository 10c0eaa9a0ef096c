"""Closing loops with given parameters: true values of the quantities that are not driven.

Newton's method on f(x, p) = 0 with LAPACK, pose by pose in stacks, and on purpose not the
estimator's own elimination: what is simulated here checks what is estimated there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.expressions.domain import explain_domain
from loopcal.expressions.engine import engine_for
from loopcal.mechanisms.mechanism import Mechanism

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
    pose_constants: Array,
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
    closed = np.array(values, dtype=float)
    for part, x, at in _settled(mechanism, parameters, closed, pose_constants, unknown):
        if not at.finite.all():
            raise explain_domain(
                tape, x, pose_constants[:, part], parameters, poses[part], mechanism.remedies
            )
        _refuse_open(mechanism, at.f, x, poses[part])
    return closed


def reachable(
    mechanism: Mechanism,
    parameters: Array,
    values: Array,
    pose_constants: Array,
    unknown: Sequence[str],
) -> NDArray[np.bool_]:
    """(N,) the poses whose loops close; arguments as of `close_loops`.

    Raises InputError where loops are too few.
    """
    closed = np.array(values, dtype=float)
    settled = _settled(mechanism, parameters, closed, pose_constants, unknown)
    parts = [at.finite & _closed(at.f, x) for _, x, at in settled]
    return np.concatenate(parts) if parts else np.zeros(0, dtype=bool)


def closed_within(
    mechanism: Mechanism,
    parameters: Array,
    values: Array,
    pose_constants: Array,
    free: Mapping[str, tuple[ArrayLike, ArrayLike]],
) -> tuple[Array, NDArray[np.bool_]]:
    """All quantities (k, N), those that are free moved within their spans [SI] by least steps
    until the loops close, and (N,) whether they do; other arguments as of `close_loops`."""
    closed = np.array(values, dtype=float)
    bounds = np.array(
        [[np.broadcast_to(end, closed.shape[1]) for end in span] for span in free.values()]
    ).reshape(len(free), 2, closed.shape[1])
    settled = _settled(mechanism, parameters, closed, pose_constants, tuple(free), bounds)
    parts = [at.finite & _closed(at.f, x) for _, x, at in settled]
    return closed, np.concatenate(parts) if parts else np.zeros(0, dtype=bool)


@dataclass(frozen=True)
class _Settled:
    """Loop values (m, b), and the poses (b,) where they and their derivatives are numbers."""

    f: Array
    finite: NDArray[np.bool_]


def _settled(
    mechanism: Mechanism,
    parameters: Array,
    closed: Array,
    pose_constants: Array,
    unknown: Sequence[str],
    bounds: Array | None = None,
) -> Iterator[tuple[slice, Array, _Settled]]:
    """Blocks of poses with what is unknown found in place; poses without values stand still.

    bounds: (u, 2, N) within which it is found, by least steps where it may be more than the loops.
    """
    tape = mechanism.tape
    rows = [tape.quantities.index(name) for name in unknown]
    if bounds is None and len(rows) > len(tape.loops):
        raise _too_few_driven(mechanism, unknown)
    if not tape.loops:  # nothing to close
        every = np.ones((1, closed.shape[1]), dtype=bool)
        yield slice(None), closed, _Settled(np.zeros(every.shape), every[0])
        return
    angles = {name for name in unknown if mechanism.quantities[name] == "rad"}
    angles -= {turn for orientation in mechanism.orientations for turn in orientation.turns}
    turns = [i for i, name in enumerate(unknown) if name in angles]
    engine = engine_for(tape, (), min(_BLOCK, max(closed.shape[1], 1)))
    for begin in range(0, closed.shape[1], _BLOCK):
        part = slice(begin, begin + _BLOCK)
        x, c = closed[:, part], pose_constants[:, part]
        for _ in range(_MOST):
            loops = engine.evaluate(parameters, x, c)
            numbers = np.isfinite(np.concatenate([loops.f[None], loops.by_quantity]))
            finite = np.asarray(numbers.all(axis=(0, 1)))
            step = np.zeros((len(rows), x.shape[1]))
            slopes, f = loops.by_quantity[rows][:, :, finite], loops.f[:, finite]
            step[:, finite] = _newton_step(slopes, f)
            if bounds is not None:
                low, high = bounds[:, 0, part], bounds[:, 1, part]
                # What stands at its bound and would leave it lets the others move instead.
                stands = ((x[rows] <= low) & (step > 0.0)) | ((x[rows] >= high) & (step < 0.0))
                step[:, finite] = _newton_step(slopes * ~stands[:, None, finite], f)
            largest = np.abs(step[turns]).max(axis=0, initial=0.0)
            # The whole step is scaled, not its angles alone: Newton's direction stays.
            step *= _TURN / np.maximum(largest, _TURN)
            before = x[rows]
            after = before - step
            if bounds is not None:
                after = np.clip(after, bounds[:, 0, part], bounds[:, 1, part])
            x[rows], step = after, before - after
            if np.abs(step).max(initial=0.0) <= _STEP * max(1.0, np.abs(x).max(initial=0.0)):
                break
        yield part, x, _Settled(engine.evaluate(parameters, x, c).f, finite)


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
    # solve where the loops determine the unknowns, least squares where there are more loops.
    J = np.ascontiguousarray(by_unknown.transpose(2, 1, 0))
    right = np.ascontiguousarray(f.T)[..., None]
    if J.shape[1] == J.shape[2]:
        try:
            return np.ascontiguousarray(np.linalg.solve(J, right)[..., 0].T)
        except np.linalg.LinAlgError:
            pass
    return np.ascontiguousarray((np.linalg.pinv(J) @ right)[..., 0].T)


def _closed(f: Array, x: Array) -> NDArray[np.bool_]:
    """(b,) whether loop values (m, b) are zero but for rounding."""
    limit = _OPEN * np.maximum(1.0, np.abs(x).max(axis=0))
    closed: NDArray[np.bool_] = np.abs(f).max(axis=0) <= limit
    return closed


def _refuse_open(mechanism: Mechanism, f: Array, x: Array, poses: Sequence[str]) -> None:
    worst = np.abs(f).max(axis=0)
    still_open = ~_closed(f, x)
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
