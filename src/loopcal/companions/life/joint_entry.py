"""What a history keeps of a calibration beside each parameter: what all of them say together.

Instruments are placed anew each day. So the covariance is that of what remains when placements may
be anything, and a change v of the parameters moves the measured points of the calibration's poses
by the root mean square sqrt(v^T M v), M = S^T P S / (points), S the derivatives of the points, P
what no placement takes up. What is mounted is kept with the machine: where it is mounted anew, that
is a cause beside those of the machine. Terms of the model error are left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.companions.life.courses import Cause
from loopcal.companions.life.drift import Drifting
from loopcal.document.plain import lower, symmetric
from loopcal.mechanisms.outputs import measured_points
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.comparison import sensitivity, thinned
from loopcal.statistics.replacing import least_squares

TOGETHER = "several parameters"
"""The name of changes that are those of no single cause."""
# Chosen, not derived: what a placement takes up leaves rounding, and the bend of a large turn.
_TAKEN_UP = 0.01
"""Sd of the best parameter in its unit over that of a joint's zero, below which the zero is one of
the placement."""


@dataclass(frozen=True, eq=False)
class Joint:
    """Of n parameters: names; covariance and moves M, None where no points are seen, (n, n) [SI].

    zeros: joints whose zero is no parameter; for each, how the parameters (n,) change with its zero
    [SI per unit of the joint]. units: of these joints.
    """

    names: tuple[str, ...]
    covariance: Array
    moves: Array | None
    zeros: Mapping[str, Array]
    units: Mapping[str, str]

    @classmethod
    def of(cls, calibrated: Calibrated, names: Sequence[str]) -> Joint:
        """Of these estimated parameters."""
        every, poses = calibrated.mechanism.parameters.names, calibrated.poses
        at = np.array([every.index(name) for name in names], dtype=np.intp)
        covariance = calibrated.by_residuals.covariance.matrix[np.ix_(at, at)]
        if poses is None or not names:
            return cls(tuple(names), covariance, None, {}, {})
        zeros = {joint: v[at] for joint, v in Drifting(calibrated, poses, None).zeros.items()}
        shown = _shown(calibrated, names, covariance, zeros)
        zeros = {joint: v for joint, v in zeros.items() if joint in shown}
        moves = _moves(calibrated, at)
        units = {joint: calibrated.mechanism.quantities[joint] for joint in zeros}
        return cls(tuple(names), covariance, moves, zeros, units)

    @classmethod
    def of_content(cls, content: Mapping[str, Any]) -> Joint:
        """From an entry; one that older versions wrote has the sds alone."""
        if (kept := content.get("joint")) is None:
            sds = {name: one["sd"] for name, one in content["parameters"].items()}
            return cls(tuple(sds), np.diag(np.square([*sds.values()])), None, {}, {})
        moves = None if kept["moves"] is None else symmetric(kept["moves"])
        zeros = {joint: np.array(v, float) for joint, v in kept["zeros"].items()}
        covariance = symmetric(kept["covariance"])
        return cls(tuple(kept["names"]), covariance, moves, zeros, kept["units"])

    @property
    def content(self) -> dict[str, Any] | None:
        """For an entry; None where nothing bounds the covariance."""
        if not np.isfinite(self.covariance).all() or not (np.diag(self.covariance) > 0.0).all():
            return None
        return {
            "names": list(self.names),
            "covariance": lower(self.covariance),
            "moves": None if self.moves is None else lower(self.moves),
            "zeros": {joint: v.tolist() for joint, v in self.zeros.items()},
            "units": dict(self.units),
        }

    def among(self, names: Sequence[str]) -> Joint:
        """Of these alone, as far as they are there, whatever the others are."""
        at = np.array([i for i, name in enumerate(self.names) if name in names], dtype=np.intp)
        moves = None if self.moves is None else self.moves[np.ix_(at, at)]
        zeros = {joint: v[at] for joint, v in self.zeros.items()}
        covariance = self.covariance[np.ix_(at, at)]
        return Joint(tuple(self.names[i] for i in at), covariance, moves, zeros, self.units)


def _shown(
    calibrated: Calibrated, names: Sequence[str], covariance: Array, zeros: Mapping[str, Array]
) -> set[str]:
    """The joints whose zero does more than placements take up."""
    sd, quantities = np.sqrt(np.diag(covariance)), calibrated.mechanism.quantities
    if not np.isfinite(covariance).all() or not (sd > 0.0).all():
        return set()
    information = np.linalg.pinv(covariance / np.outer(sd, sd), hermitian=True)
    size = {joint: float(v / sd @ information @ (v / sd)) for joint, v in zeros.items()}
    alone, most = np.diag(information) / np.square(sd), dict[str, float]()
    of_parameters = [calibrated.mechanism.parameters[name].unit for name in names]
    for unit, value in (
        *zip(of_parameters, alone.tolist(), strict=True),
        *((quantities[joint], value) for joint, value in size.items()),
    ):
        most[unit] = max(value, most.get(unit, 0.0))
    return {q for q, value in size.items() if value > _TAKEN_UP**2 * most[quantities[q]]}


def _moves(calibrated: Calibrated, at: NDArray[np.intp]) -> Array | None:
    """M of the parameters at these positions."""
    mechanism, poses = calibrated.mechanism, calibrated.poses
    points = [outputs for outputs in measured_points(mechanism) if outputs]
    rows = [mechanism.outputs.index(q) for outputs in points for q in outputs]
    rows = [i for i in rows if mechanism.quantities[mechanism.outputs[i]] == "m"]
    if poses is None or not rows:
        return None
    S = sensitivity(calibrated, thinned(poses))[:, rows]
    S = S[np.isfinite(S).all(axis=(1, 2))]
    count = len(S) * len(points)
    if not count:
        return None
    S = S.reshape(-1, S.shape[2])
    placed = [i for i, p in enumerate(mechanism.parameters) if p.role == "placement"]
    left = S[:, at] - S[:, placed] @ least_squares(S[:, placed], S[:, at])
    return np.asarray(left.T @ left / count)


def causes(
    last: Joint, names: Sequence[str], parameters: Mapping[str, Mapping[str, Any]]
) -> tuple[Cause, ...]:
    """What may have changed of the parameters with these names: zeros of joints, single ones, what
    is mounted, and several together where their effect in m is known.

    parameters: unit, role and owner by name.
    """
    one, out, mounted = np.eye(len(names)), list[Cause](), dict[str, list[int]]()
    for joint, v in last.zeros.items():
        steps = dict(zip(last.names, v.tolist(), strict=True))
        direction = np.array([[steps.get(name, 0.0)] for name in names])
        if direction.any():
            out.append(Cause(f"zero of {joint}", last.units[joint], direction, often=True))
    for i, name in enumerate(names):
        entry = parameters[name]
        if entry.get("role") == "mounting":
            mounted.setdefault(entry.get("owner") or name, []).append(i)
        else:
            out.append(Cause(name, entry["unit"], one[:, [i]], entry.get("role") == "zero"))
    machine = [i for i, name in enumerate(names) if parameters[name].get("role") != "mounting"]
    for owner, at in mounted.items():
        title = owner if len(at) > 1 else names[at[0]]
        out.append(Cause(title, parameters[names[at[0]]]["unit"], one[:, at]))
    if len(machine) > 1 and last.moves is not None:
        out.append(Cause(TOGETHER, "m", one[:, machine], together=True))
    return tuple(out)
