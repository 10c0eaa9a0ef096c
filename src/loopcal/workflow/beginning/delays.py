"""How late an instrument is behind the joints, from its readings while the robot moves.

The machine that least squares finds from the stands says where the point p was at joints
q(t - tau). What it misses at both ends of a move is interpolated along the way and added to p. A
delay moves the point by w = dp/dtau; with the readings m(t) and by least squares over all moves

    tau = sum_k w_k^T (m - p)_k / sum_k w_k^T w_k.

In a long recording two clocks drift apart: tau = tau_0 + r (t - t_0), t_0 its middle, and both are
estimated. The machine's own error bends between two stands, alike for all readings of a move and
unlike for those of another. Hence the sds are those of the moves about each other (a sandwich by
cluster, Liang and Zeger 1986), with K / (K - q) for K moves and q numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.estimation.calibrate import calibrate
from loopcal.estimation.fit import Fit
from loopcal.estimation.methods.least_squares import METHOD
from loopcal.estimation.problem.alignment import align
from loopcal.files.recognition.fields import Field
from loopcal.files.recognition.logs import Columns
from loopcal.files.recognition.meanings import Meaning
from loopcal.files.tables.recording import MARGIN, Recording, Series
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.presentation.shown import rounded_by_sd, significant
from loopcal.units import to_si, unit
from loopcal.workflow.beginning.searching import Machine, Understood

_STEP = 1e-3
"""[s] of the difference quotient of the point by the delay."""
_ROUNDS = 6
_MOVES = 4
"""Fewer moves say little of how they scatter."""
_LONG = 600.0
"""[s] from which the clocks of a recording may drift apart: 10 ppm are then 6 ms."""


@dataclass(frozen=True)
class Delay:
    """Of an instrument behind the joints [s], with its sd, by so many moves.

    drift: by how much its clock is slower [s/s], with its sd; None of a short recording, else the
    delay is that of the middle.
    """

    topic: str
    value: float
    sd: float
    moves: int
    drift: float | None = None
    drift_sd: float = 0.0

    def __str__(self) -> str:
        value, sd = rounded_by_sd(1e3 * self.value, 1e3 * self.sd), significant(1e3 * self.sd, 2)
        return (
            f"{self.topic}: its delay behind the joints is {value} ms (sd {sd} ms), from "
            f"{self.moves} moves. The readings are taken where it stands, allowing for this delay."
        ) + self._drifting

    @property
    def _drifting(self) -> str:
        if self.drift is None:
            return ""
        sd = significant(1e6 * self.drift_sd, 2)
        value = rounded_by_sd(1e6 * self.drift, 1e6 * self.drift_sd)
        return f" It changes by {value} ppm of the time (sd {sd} ppm): the clocks drift apart."


def delays(
    mechanism: Mechanism, dataset: Dataset, understood: Understood, columns: Columns
) -> tuple[Delay, ...]:
    """Those of the instruments that were recorded by time with the joints; none of an instrument
    that reads no points, or saw too few moves.

    mechanism, dataset: of the project, the poses at rest.
    """
    if not columns.at:
        return ()
    # Between stands the machine as they determine it misses less than the nominal one.
    with suppress(InputError):
        mechanism = calibrate(mechanism, dataset, fit=Fit(method=METHOD)).calibrated
    machine = Machine(mechanism, tuple(understood.joints))
    made = []
    for meaning in understood.seen:
        place = [columns.at.get((f.table, f.position)) for f in meaning.seen.position]
        joints = [columns.at.get((f.table, f.position)) for f in understood.layout.joints]
        if meaning.seen.kind not in ("point", "pose") or meaning.inverted:
            continue
        if any(f.computed for f in understood.layout.joints):  # they have no series of their own
            continue
        if any(one is None for one in (*place, *joints)) or meaning.seen.station:
            continue
        delay = _delay(machine, understood, meaning, columns)
        made += [] if delay is None else [delay]
    return tuple(made)


def _delay(
    machine: Machine, understood: Understood, meaning: Meaning, columns: Columns
) -> Delay | None:
    meaning = meaning.fitted(machine.bodies(dict(understood.joints)))
    if meaning.fit is None:
        return None
    fields = meaning.seen.position
    series, _ = columns.at[fields[0].table, fields[0].position]
    recording, topic = _recorded(columns, series)
    t = series.times
    m = np.column_stack([_values(columns, f, f.unit or meaning.length) for f in fields])
    target = meaning.fit.targets[0]
    joints = _joints(machine, understood, columns)

    def body(times: Array) -> Array:
        """(N, 3) the target in the machine's base."""
        return machine.bodies({name: q(times) for name, q in joints.items()}).at(target)

    middle = recording.stands.mean(axis=1)
    at_rest = body(middle)
    try:
        motion = align(at_rest.T, meaning.position.T)
    except InputError:
        return None
    missed = meaning.position - (at_rest @ motion.rotation.T + motion.shift)
    q_rest = np.column_stack([q(middle) for q in joints.values()])
    late = recording.late[topic]
    read: NDArray[np.bool_] = np.asarray(np.isfinite(m).all(axis=1))
    moves = list(_moves(recording, t - late, read, missed))
    if len(moves) < _MOVES:
        return None
    rows = np.concatenate([rows for _, rows in moves])
    ends = np.cumsum([len(rows) for _, rows in moves])[:-1]
    k = np.concatenate([np.full(len(rows), k) for k, rows in moves])
    basis = np.ones((len(rows), 1))
    if t[-1] - t[0] > _LONG:
        basis = np.column_stack([basis, t[rows] - 0.5 * (t[0] + t[-1])])
    count, size = len(moves), basis.shape[1]
    tau, step = np.array([late, 0.0])[:size], np.zeros(size)
    A, g = np.zeros((size, size)), np.zeros((count, size))
    for _ in range(_ROUNDS):
        now = t[rows] - basis @ tau
        p = body(now) @ motion.rotation.T + motion.shift
        w = (body(now - _STEP) - body(now + _STEP)) @ motion.rotation.T / (2.0 * _STEP)
        q = np.column_stack([one(now) for one in joints.values()])
        way = q_rest[k + 1] - q_rest[k]
        share = np.clip(np.sum((q - q_rest[k]) * way, axis=1) / np.sum(way**2, axis=1), 0.0, 1.0)
        along = missed[k] + share[:, None] * (missed[k + 1] - missed[k])
        left = m[rows] - p - along
        A = (basis * np.sum(w * w, axis=1)[:, None]).T @ basis
        each = basis * np.sum(w * left, axis=1)[:, None]
        if np.linalg.matrix_rank(A, hermitian=True) != size:
            return None
        step = np.linalg.solve(A, each.sum(axis=0))
        tau = tau + step
        # Of each move at the end.
        each = each - basis * (np.sum(w * w, axis=1) * (basis @ step))[:, None]
        g = np.array([part.sum(axis=0) for part in np.split(each, ends)])
        if np.abs(step).max() < 1e-9:
            break
    inverse = np.linalg.inv(A)
    sds = np.sqrt(np.diag(inverse @ (g.T @ g) @ inverse) * count / (count - size))
    drift = () if size == 1 else (float(tau[1]), float(sds[1]))
    return Delay(topic, float(tau[0]), float(sds[0]), count, *drift)


def _moves(
    recording: Recording, times: Array, read: NDArray[np.bool_], missed: Array
) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """Number of the stand before a move, and the readings during it; both stands were measured."""
    for k, (leaves, comes) in enumerate(
        zip(recording.stands[:-1, 1], recording.stands[1:, 0], strict=True)
    ):
        inside = read & (times > leaves - MARGIN) & (times < comes + MARGIN)
        if inside.sum() > 2 and np.isfinite(missed[k : k + 2]).all():
            yield k, np.flatnonzero(inside)


def _recorded(columns: Columns, series: Series) -> tuple[Recording, str]:
    return next(
        (recording, topic)
        for recording in columns.recordings
        for topic, one in recording.measured.items()
        if one is series
    )


def _values(columns: Columns, field: Field, unit_name: str) -> Array:
    series, column = columns.at[field.table, field.position]
    return np.asarray(unit(unit_name).factor * series.values[:, column])


def _joints(
    machine: Machine, understood: Understood, columns: Columns
) -> dict[str, Callable[[Array], Array]]:
    """Name -> q(t) [SI] by a cubic spline through its readings, held at both ends."""
    from scipy.interpolate import CubicSpline

    made: dict[str, Callable[[Array], Array]] = {}
    every = zip(machine.joints, understood.layout.joints, understood.units, strict=True)
    for name, field, unit_name in every:
        series, column = columns.at[field.table, field.position]
        times, first = np.unique(series.times, return_index=True)
        values = to_si(series.values[first, column], unit_name)
        spline = CubicSpline(times, values)
        low, high = times[0], times[-1]
        made[name] = lambda t, s=spline, a=low, b=high: s(np.clip(t, a, b))  # type: ignore[misc]
    return made
