"""Ways from pose to pose, many at once (N, 4, 4), and where a tool sits.

A twist of two poses is (v, w), the shift of the origin and the turn,
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
from loopcal.mechanisms.rotations import rotation_by, rotation_vector
from loopcal.mechanisms.station import pose_of


def between(T: Array, target: Array) -> Array:
    """(..., 6) the twist that leads from poses T to the target: shift and turn."""
    turn = rotation_vector(target[..., :3, :3] @ np.swapaxes(T[..., :3, :3], -1, -2))
    return np.concatenate([target[..., :3, 3] - T[..., :3, 3], turn], axis=-1)


def moved(T: Array, twist: Array, share: float) -> Array:
    """The poses a share of a twist onwards: the origin straight, the turn about one axis."""
    R = rotation_by(share * twist[..., 3:]) @ T[..., :3, :3]
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
    values = [_numbers(point, turns, mechanism.parameters.nominal)]
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
