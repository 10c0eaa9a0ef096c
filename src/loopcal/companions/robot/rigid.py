"""Many poses at once: logarithms, exponentials and ways of writing rigid motions, (N, 4, 4).

Turns are rotation vectors. A twist of two poses is (v, w), the shift of the origin and the turn,
both in the frame of the poses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.placement import rigid
from loopcal.mechanisms.station import pose_of


def turned(w: Array) -> Array:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), by Rodrigues' formula."""
    angle = np.linalg.norm(w, axis=-1)[..., None, None]
    K = crossing(w)
    # Below, sin(a)/a and (1 - cos a)/a^2 equal 1 and 1/2 to rounding.
    small = angle < 1e-8
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 1.0, np.sin(safe) / safe)
    second = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    R: Array = np.eye(3) + first * K + second * (K @ K)
    return R


def crossing(w: Array) -> Array:
    """(..., 3, 3) the matrix of v -> w x v."""
    K = np.zeros((*w.shape, 3))
    K[..., 2, 1], K[..., 0, 2], K[..., 1, 0] = w[..., 0], w[..., 1], w[..., 2]
    made: Array = K - np.swapaxes(K, -1, -2)
    return made


def turn_of(R: Array) -> Array:
    """Rotation vectors (..., 3) of rotation matrices (..., 3, 3), of at most half a turn."""
    q = quaternion_of(R)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., :1])
    w: Array = np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 2.0) * q[..., 1:]
    return w


def quaternion_of(R: Array) -> Array:
    """Unit quaternions (..., 4), w first and not negative, of rotation matrices (..., 3, 3).

    The largest of four ways to begin is taken (Shepperd 1978).
    """
    t = np.einsum("...ii->...i", R)
    trace = t.sum(axis=-1)
    squares = np.stack([trace, *np.moveaxis(2.0 * t - trace[..., None], -1, 0)], axis=-1)
    M = np.empty((*trace.shape, 4, 4))  # 4 q_i q_j
    for i in range(4):
        M[..., i, i] = 1.0 + squares[..., i]
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        M[..., 0, i + 1] = M[..., i + 1, 0] = R[..., k, j] - R[..., j, k]
        M[..., j + 1, k + 1] = M[..., k + 1, j + 1] = R[..., j, k] + R[..., k, j]
    best = np.argmax(squares, axis=-1)
    q = np.take_along_axis(M, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    signed: Array = np.where(q[..., :1] < 0.0, -q, q)
    return signed


def between(T: Array, target: Array) -> Array:
    """(..., 6) the twist that leads from poses T to the target: shift and turn."""
    turn = turn_of(target[..., :3, :3] @ np.swapaxes(T[..., :3, :3], -1, -2))
    return np.concatenate([target[..., :3, 3] - T[..., :3, 3], turn], axis=-1)


def moved(T: Array, twist: Array, share: float) -> Array:
    """The poses a share of a twist onwards: the origin straight, the turn about one axis."""
    R = turned(share * twist[..., 3:]) @ T[..., :3, :3]
    return rigid(R, T[..., :3, 3] + share * twist[..., :3])


# Where the tool of a program sits on the last link: for the machine, and for its controller.

CALIBRATED, NOMINAL = "calibrated", "nominal"


@dataclass(frozen=True, eq=False)
class Tool:
    """A frame on the body, Tx Ty Tz Rz Ry Rx.

    point: its coordinates [m], or the names of the parameters that hold them, in the machine;
    turns: names of the parameters of its turns z, y, x, empty where it has none; of_machine,
    of_controller: numbers (6,) x, y, z [m], rz, ry, rx [rad]; observed: whether its turn was
    measured.
    """

    point: tuple[float, ...] | tuple[str, ...]
    turns: tuple[str, ...]
    of_machine: Array
    of_controller: Array

    @property
    def observed(self) -> bool:
        """Whether an instrument saw how the tool is turned."""
        return bool(self.turns)

    def moved_to(self, point: Array) -> Tool:
        """The tool at another point (3,) [m] of the body; in the controller too, if it has the
        machine's numbers."""
        numbers = np.concatenate([point, self.of_machine[3:]])
        alike = self.of_controller is self.of_machine
        return replace(
            self, of_machine=numbers, of_controller=numbers if alike else self.of_controller
        )


def tool_of(
    mechanism: Mechanism, nominal: Mapping[str, float], stated: str | Sequence[float] = CALIBRATED
) -> Tool:
    """The tool of a program.

    stated: "calibrated": what the first instrument looks at, also entered in the controller;
    "nominal": the same, but the controller has its drawn values; or x, y, z [m] and rz, ry, rx
    [rad] (or none) on the last link, in both. Raises InputError for anything else.
    """
    if not isinstance(stated, str):
        numbers = np.array(stated, dtype=float)
        if numbers.shape not in ((3,), (6,)) or not np.isfinite(numbers).all():
            raise InputError(
                f"the tool has {numbers.size} numbers",
                code="wrong-shape",
                remedy="give x, y, z and, if it is turned, rz, ry, rx",
            )
        numbers = np.concatenate([numbers, np.zeros(6 - numbers.size)])
        return Tool(tuple(map(float, numbers[:3])), (), numbers, numbers)
    if stated not in (CALIBRATED, NOMINAL):
        raise InputError(
            f"the tool is {stated!r}",
            code="unknown-name",
            remedy="give 'calibrated', 'nominal', or the numbers x, y, z, rz, ry, rx",
        )
    names = next((f.mounted for f in mechanism.families if f.mounted), ())
    units = {name: mechanism.parameters[name].unit for name in names}
    point = tuple(n for n in names if units[n] == "m")[:3]
    turns = tuple(n for n in names if units[n] == "rad")
    turns = turns if len(turns) == 3 else ()
    values = [_numbers(point, turns, {p.name: p.nominal for p in mechanism.parameters})]
    values.append(_numbers(point, turns, nominal) if stated == NOMINAL else values[0])
    if len(point) < 3:
        return Tool((0.0, 0.0, 0.0), (), values[0], values[0])
    return Tool(point, turns, *values)


def _numbers(point: Sequence[str], turns: Sequence[str], values: Mapping[str, float]) -> Array:
    numbers = np.zeros(6)
    numbers[: len(point)] = [values[name] for name in point]
    numbers[3 : 3 + len(turns)] = [values[name] for name in turns]
    return numbers


def turning(tool: Tool) -> Array:
    """(3, 3) columns: the turns of the tool by each of rz, ry, rx, in the frame of the body."""
    rz, ry, _ = tool.of_machine[3:]
    # Rz Ry Rx: each turn is about the axis that the turns before it have left.
    about_y, about_x = (pose_of((0.0, 0.0, 0.0, rz, turn, 0.0))[:3, :3] for turn in (0.0, ry))
    return np.stack([np.array([0.0, 0.0, 1.0]), about_y[:, 1], about_x[:, 0]], axis=1)
