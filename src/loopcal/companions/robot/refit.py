"""Part of a machine's parameters refitted to what its full model predicts.

What goes into a controller is less than what was calibrated: zeros, tool and base alone, or the
geometry without sag, gears and discrepancy. The half of a joint estimate means little by itself;
what is exported is therefore the part that predicts best what the full model does in the working
region:

    min over u of  sum |p_full(q) - p(q; u)|^2 / s^2 + sum (u - u_0)^2 / w^2.

s is 10 um; w, for geometry, 5 mm or 50 mrad: what the region does not determine stays at u_0.

The points of a serial arm that instruments measured, as chains, with their derivatives.

A point t of the body is seen at p = S_1 S_2 ... S_n t, the steps from the instrument to the body.
The derivative of p by the amount of a step about (along) the axis e through o is e x (p - o) (e).
By a joint's reading, a zero offset of it, or a parameter it is the sum over the steps of that name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from loopcal.arrays import Array
from loopcal.mechanisms.chain import Step, frames
from loopcal.mechanisms.mechanism import Family, Mechanism
from loopcal.mechanisms.outputs import point_outputs, points
from loopcal.mechanisms.station import Station
from loopcal.mechanisms.structure.structured import MOUNTED

# s of the criterion, 10 um: against it the 5 mm of w only hold what the region leaves open.
_NOISE = 1e-5
# Gauss-Newton from a nominal geometry ends in a few steps; the rest is reserve.
_STEPS, _SETTLED = 30, 1e-12
_ALIKE = 5e-5
"""Of a column, what is left of one that the columns before it can express."""


@dataclass(frozen=True, eq=False)
class Goal:
    """A point, the readings (N,) of the arm's joints, and where the point is to be (N, 3)."""

    seen: SeenPoint
    joints: Mapping[str, Array]
    points: Array

    @classmethod
    def of(cls, seen: SeenPoint, readings: Mapping[str, Array]) -> Goal:
        """The point where readings of it are."""
        joints = {step.joint: readings[step.joint] for step in seen.steps if step.joint}
        return cls(seen, joints, seen.measured(readings))


@dataclass(frozen=True, eq=False)
class Refit:
    """values: parameters [SI] by name, the refitted among them; offsets: of joint readings [SI];
    names: what was refitted; map: (n, rows) change of these per change of the goals' points."""

    values: Mapping[str, float]
    offsets: Mapping[str, float]
    names: tuple[str, ...]
    map: Array

    def distances(self, goals: Sequence[Goal]) -> Array:
        """[m] from the goals."""
        left = [g.points - _trace(g, self.values, self.offsets).points for g in goals]
        lengths: Array = np.linalg.norm(np.concatenate(left), axis=1)
        return lengths


def refit(
    goals: Sequence[Goal],
    values: Mapping[str, float],
    names: Sequence[str],
    joints: Sequence[str] = (),
    *,
    units: Mapping[str, str] | None = None,
) -> Refit:
    """The parameters `names` and zero offsets of `joints` that come nearest to the goals.

    values: of all parameters, those to be refitted at their start; units: of the parameters, where
    they are to stay near the start. Gauss-Newton; the offsets start at 0.
    """
    start = np.array([*(values[n] for n in names), *(0.0 for _ in joints)])
    u = start.copy()
    weight = (
        np.zeros(len(u)) if units is None else _NOISE / np.array([MOUNTED[units[n]] for n in names])
    )
    fitted_names = [*names, *joints]
    A = np.zeros((0, len(fitted_names)))
    for _ in range(_STEPS):
        now = _with(values, names, u)
        offsets = dict(zip(joints, u[len(names) :].tolist(), strict=True))
        A, left = _system(goals, fitted_names, now, offsets)
        scale = np.sqrt(np.square(A).sum(axis=0) + np.square(weight))
        scale[scale == 0.0] = 1.0
        B = np.vstack([A, np.diag(weight)]) / scale
        step = (
            np.linalg.lstsq(B, np.concatenate([left, weight * (start - u)]), rcond=1e-10)[0] / scale
        )
        u = u + step
        if np.abs(step * scale).max(initial=0.0) < _SETTLED * np.sqrt(len(left)):
            break
    back = np.linalg.pinv(np.vstack([A, np.diag(weight)]) / scale, rcond=1e-10)[:, : len(A)]
    return Refit(
        _with(values, names, u),
        dict(zip(joints, u[len(names) :].tolist(), strict=True)),
        tuple(fitted_names),
        back / scale[:, None],
    )


def separable(
    goals: Sequence[Goal], values: Mapping[str, float], names: Sequence[str], joints: Sequence[str]
) -> tuple[str, ...]:
    """Of the joints those whose zeros do what neither `names` nor zeros of joints before do."""
    A, _ = _system(goals, [*names, *joints], values, {})
    size = np.linalg.norm(A, axis=0)
    A = A / np.where(size > 0.0, size, 1.0)
    basis = np.zeros((len(A), 0))
    separate = []
    for i, name in enumerate([*names, *joints]):
        rest = A[:, i] - basis @ (basis.T @ A[:, i])
        # Twice is enough (Kahan and Parlett).
        rest = rest - basis @ (basis.T @ rest)
        length = float(np.linalg.norm(rest))
        if length > _ALIKE:
            basis = np.column_stack([basis, rest / length])
            if i >= len(names):
                separate.append(name)
    return tuple(separate)


def _with(values: Mapping[str, float], names: Sequence[str], u: Array) -> dict[str, float]:
    return dict(values) | dict(zip(names, u.tolist(), strict=False))


def _trace(goal: Goal, values: Mapping[str, float], offsets: Mapping[str, float]) -> Traced:
    joints = {q: v + offsets.get(q, 0.0) for q, v in goal.joints.items()}
    return traced(goal.seen.steps, goal.seen.target, joints, values)


def _system(
    goals: Sequence[Goal],
    names: Sequence[str],
    values: Mapping[str, float],
    offsets: Mapping[str, float],
) -> tuple[Array, Array]:
    """Derivatives (rows, n) of all points, and what is left to the goals (rows,)."""
    parts, left = [], []
    for goal in goals:
        now = _trace(goal, values, offsets)
        none = np.zeros(goal.points.shape)
        parts.append(np.stack([now.by.get(n, none) for n in names], axis=2).reshape(-1, len(names)))
        left.append((goal.points - now.points).ravel())
    return np.vstack(parts), np.concatenate(left)


@dataclass(frozen=True)
class SeenPoint:
    """A point of the body as one instrument sees it: steps, and the names of its coordinates."""

    family: Family
    outputs: tuple[str, ...]
    steps: tuple[Step, ...]
    target: tuple[str, ...]

    def measured(self, readings: Mapping[str, Array]) -> Array:
        """(N, 3) [m] of readings of its outputs, NaN where absent."""
        return points(self.family, np.array([readings[q] for q in self.outputs])).T


@dataclass(frozen=True, eq=False)
class Traced:
    """points: (N, 3) [m]; by: joint or parameter -> their derivative (N, 3)."""

    points: Array
    by: Mapping[str, Array]


def seen_points(mechanism: Mechanism) -> tuple[SeenPoint, ...]:
    """The points in space that instruments see of an arm or a tree; none of other machines."""
    tree = mechanism.tree
    if tree is None:
        return ()
    seen = []
    for family in mechanism.families:
        outputs = point_outputs(mechanism, family)
        target = tuple(n for n in family.mounted if mechanism.parameters[n].unit == "m")
        if len(outputs) != 3 or len(target) not in (0, 3):
            continue
        stands = family.placement
        station = stands.steps if isinstance(stands, Station) else ()
        steps = (*station, *tree.path(family.on, family.against))
        seen.append(SeenPoint(family, outputs, steps, target))
    return tuple(seen)


def traced(
    steps: Sequence[Step],
    target: Sequence[str],
    joints: Mapping[str, Array],
    values: Mapping[str, float],
) -> Traced:
    """A point at the end of a chain, at joint readings (N,) and parameter values [SI]."""
    *ahead, (R, o) = frames(steps, joints, values)
    t = np.array([values[n] for n in target] or [0.0, 0.0, 0.0])
    p = o + R @ t
    by: dict[str, Array] = {name: R[:, :, i] for i, name in enumerate(target)}
    for step, (axes, origin) in zip(steps, ahead, strict=True):
        axis = axes[:, :, "xyz".index(step.motion[1])]
        column = axis if step.motion[0] == "t" else np.cross(axis, p - origin)
        for name, weight in ((step.parameter, step.sign), (step.joint, step.direction)):
            if name is not None:
                by[name] = by.get(name, 0.0) + weight * column
    return Traced(p, by)
