"""What happens to a machine, to its instrument or to the file on one day."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analyses.gauntlet_truth import Arm, Array, turned_by
from analyses.lives_parallel import Palletiser, RotaryDelta, bent, relinked, rezeroed
from analyses.lives_truth import DEGREE, Conditions, Machine, Rng


@dataclass(frozen=True)
class Planted:
    """One change as it truly is.

    size [unit]: of the change, as one number; parameters: names that an answer may give it; pose:
    the first or the only pose that it concerns, counted from 1; words: what else is of interest.
    """

    kind: str
    size: float = 0.0
    unit: str = ""
    parameters: tuple[str, ...] = ()
    pose: int | None = None
    words: str = ""

    def document(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(eq=False)
class Day:
    """A file while it is measured: events change the conditions, tampering the columns.

    rows: which pose each row of the file belongs to.
    """

    machine: Machine
    q: Array
    conditions: Conditions
    joints: Array = field(default_factory=lambda: np.zeros((0, 0)))
    points: Array = field(default_factory=lambda: np.zeros((0, 0)))
    rows: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    @property
    def columns(self) -> dict[str, list[str]]:
        """The other columns of the file."""
        every = self.machine.columns(self.conditions)
        return {key: [values[i] for i in self.rows] for key, values in every.items()}


Event = Callable[[Day, Rng], Planted]


def _direction(rng: Rng) -> Array:
    way = rng.standard_normal(3)
    return way / np.linalg.norm(way)


def _row(day: Day, rng: Rng) -> int:
    return int(rng.uniform(0.3, 0.7) * len(day.q))


def _zeros(day: Day, j: int) -> tuple[str, ...]:
    """Names of the zero of joint j, by a table, by a URDF and in a project."""
    joint = day.machine.joints[j - 1]
    return joint, f"theta_{j}", f"offset_{j}", f"{joint}_rz", f"theta_{j}_offset"


def _origin(day: Day, j: int, coordinates: Sequence[str]) -> tuple[str, ...]:
    """Names by which a URDF has the link behind joint j."""
    names = day.machine.joints
    if isinstance(day.machine.arm, Palletiser):
        names = ("J1", "J2", "elbow", "wrist", "J4")
    return tuple(f"{names[j]}_{c}" for c in coordinates)


def moved_zero(day: Day, rng: Rng) -> Planted:
    """A joint behind the first and ahead of the last of an arm: station and tool hide those."""
    last = len(day.machine.joints) - day.machine.turns
    j = int(rng.integers(2, last + 1))
    size = 0.05 * DEGREE * rng.choice([-1.0, 1.0])
    day.conditions.arm = rezeroed(day.conditions.arm, j, size)
    return Planted("zero", size, "rad", _zeros(day, j))


def another_tool(day: Day, rng: Rng) -> Planted:
    vector = 1e-3 * np.array([4.0, -6.0, 3.0])[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
    day.conditions.target = day.conditions.target + vector
    words = "(" + ", ".join(f"{1e3 * v:+.0f}" for v in vector) + ") mm"
    parameters = ("tool", "tool_x", "tool_y", "tool_z")
    return Planted("tool", float(np.linalg.norm(vector)), "m", parameters, words=words)


def slipped(day: Day, rng: Rng) -> Planted:
    row, size = _row(day, rng), rng.uniform(5e-4, 1e-3)
    day.conditions.target[row:, 0] += size * _direction(rng)
    return Planted("slip", size, "m", ("tool", "tool_x", "tool_y", "tool_z"), row + 1)


def drifting(low: float, high: float) -> Event:
    """An instrument that drifts in one direction, by so much over the run [m]."""

    def event(day: Day, rng: Rng) -> Planted:
        size = rng.uniform(low, high)
        day.conditions.drift += np.linspace(0.0, size, len(day.q))[:, None] * _direction(rng)
        return Planted("drift", size, "m")

    return event


def warm_machine(day: Day, rng: Rng) -> Planted:
    kelvin = rng.uniform(8.0, 16.0)
    day.conditions.warmth += np.linspace(0.0, kelvin, len(day.q))
    size = kelvin * day.conditions.arm.expansion
    return Planted("warm machine", size, "1", words=f"{kelvin:.0f} K")


def heavier(day: Day, rng: Rng) -> Planted:
    arm = day.conditions.arm
    assert isinstance(arm, Arm)
    day.conditions.arm = replace(arm, tool_mass=arm.tool_mass + 5.0)
    return Planted("payload", 5.0, "kg")


def unrecorded_loads(day: Day, rng: Rng) -> Planted:
    """Every second pose has a load that no column states."""
    day.conditions.more[1::2] += 5.0
    return Planted("payload", 5.0, "kg")


def bent_link(day: Day, rng: Rng) -> Planted:
    """The second or the third link, between arm axes: a crash seldom bends a wrist."""
    j = int(rng.integers(2, 4))
    sign = rng.choice([-1.0, 1.0])
    arm = day.conditions.arm
    if isinstance(arm, RotaryDelta):
        day.conditions.arm = bent(arm, j, 3e-4 * sign)
        return Planted("bend", 3e-4 * sign, "m", (f"proximal_{j}",))
    if rng.random() < 0.5:
        day.conditions.arm = relinked(arm, j, a=3e-4 * sign)
        return Planted("bend", 3e-4 * sign, "m", (f"a_{j}", *_origin(day, j, "xyz")))
    day.conditions.arm = relinked(arm, j, alpha=5e-4 * sign)
    angles = (f"alpha_{j}", *_origin(day, j, ("rx", "ry", "rz")))
    return Planted("bend", 5e-4 * sign, "rad", angles)


def within_the_run(event: Event) -> Event:
    """What changes the machine, somewhere in the middle of the run."""

    def later(day: Day, rng: Rng) -> Planted:
        arm, row = day.conditions.arm, _row(day, rng)
        planted = event(day, rng)
        day.conditions.later = row, day.conditions.arm
        day.conditions.arm = arm
        return replace(planted, pose=row + 1)

    return later


def moved_station(day: Day, rng: Rng) -> Planted:
    row, size = _row(day, rng), 1e-3
    day.conditions.turn[row:] = (
        turned_by(5e-4 * _direction(rng)[None])[0] @ day.conditions.turn[row]
    )
    day.conditions.shift[row:] += size * _direction(rng)
    return Planted("station", size, "m", ("base",), row + 1)


def another_scale(day: Day, rng: Rng) -> Planted:
    """The last station, or the only one, is longer by 100 ppm."""
    stand = day.conditions.shift
    day.conditions.scale[np.all(stand == stand[-1], axis=1)] += 1e-4
    return Planted("scale", 1e-4, "1")


def loose_flange(day: Day, rng: Rng) -> Planted:
    day.conditions.loose = 3e-4
    day.conditions.target += day.conditions.loose * rng.standard_normal((len(day.q), 1, 3))
    return Planted("loose flange", day.conditions.loose, "m")


def rows_shifted(day: Day, rng: Rng) -> Planted:
    day.joints, day.points, day.rows = day.joints[:-1], day.points[1:], day.rows[:-1]
    return Planted("rows shifted", 1.0, "rows")


def shuffled(day: Day, rng: Rng) -> Planted:
    day.points = day.points[rng.permutation(len(day.points))]
    return Planted("points shuffled")


def read_late(way: float) -> Event:
    """Joints that were read with this share of the way from the last pose still ahead."""

    def tamper(day: Day, rng: Rng) -> Planted:
        day.joints[1:] -= way * np.diff(day.joints, axis=0)
        return Planted("read late", way, "1")

    return tamper


def poses_off(share: float, size: float) -> Event:
    """This share of the poses, at least one, is off by as much [m]."""

    def tamper(day: Day, rng: Rng) -> Planted:
        count = max(1, int(share * len(day.q)))
        bad = np.sort(rng.permutation(len(day.q))[:count])
        for row in bad:
            day.points[row, :3] += size * _direction(rng)
        return Planted("poses off", size, "m", pose=int(bad[0]) + 1)

    return tamper


def copied(day: Day, rng: Rng) -> Planted:
    again = np.sort(rng.permutation(len(day.q))[: len(day.q) // 3])
    rows = np.append(np.arange(len(day.q)), again)
    day.joints, day.points, day.rows = day.joints[rows], day.points[rows], rows
    return Planted("copied rows", float(len(again)), "rows")


def a_column_in_inches(day: Day, rng: Rng) -> Planted:
    column = int(rng.integers(3))
    day.points[:, column] /= 25.4
    return Planted("unit", 25.4, "1", ("xyz"[column],))


def in_inches(first: float) -> Event:
    """Points in inches under a header of millimetres, from this share of the rows on."""

    def tamper(day: Day, rng: Rng) -> Planted:
        day.points[int(first * len(day.points)) :] /= 25.4
        return Planted("unit", 25.4, "1")

    return tamper


def other_angles(factor: float) -> Event:
    """Joints in another unit than their header's."""

    def tamper(day: Day, rng: Rng) -> Planted:
        day.joints = day.joints * factor
        return Planted("unit of angles", factor, "1")

    return tamper


def reversed_joints(count: int) -> Event:
    def tamper(day: Day, rng: Rng) -> Planted:
        inner = np.arange(1, len(day.machine.joints) - 1)
        chosen = np.sort(rng.permutation(inner)[:count])
        day.joints[:, chosen] *= -1.0
        return Planted("sign", 2.0, "1", _zeros(day, int(chosen[0]) + 1))

    return tamper


def joints_exchanged(day: Day, rng: Rng) -> Planted:
    day.joints[:, [3, 5]] = day.joints[:, [5, 3]]
    return Planted("joints exchanged")


def axes_exchanged(day: Day, rng: Rng) -> Planted:
    day.points[:, [0, 1]] = day.points[:, [1, 0]]
    return Planted("axes exchanged")


def left_handed(day: Day, rng: Rng) -> Planted:
    day.points[:, 1] *= -1.0
    return Planted("left-handed")


def constant_column(day: Day, rng: Rng) -> Planted:
    day.points[:, 2] = day.points[0, 2]
    return Planted("constant column", parameters=("z",))


def quaternion_rolled(day: Day, rng: Rng) -> Planted:
    """The real part first under headers that have it last."""
    day.points[:, 3:] = np.roll(day.points[:, 3:], 1, axis=1)
    return Planted("quaternion")


def made(
    machine: Machine,
    poses: int,
    rng: Rng,
    event: Event | None = None,
    tamper: Event | None = None,
    stations: int = 1,
) -> tuple[Day, Planted]:
    """A day's file and what is true of it; stations: from how many places it is measured."""
    q = machine.posed(poses, rng)
    conditions = machine.placed(machine.conditions(len(q)), rng, stations)
    measured = Day(machine, q, conditions)
    planted = Planted("")
    if event:
        planted = event(measured, rng)
    measured.rows = np.arange(len(q))
    measured.joints, measured.points = machine.measured(q, conditions, rng)
    if tamper:
        planted = tamper(measured, rng)
    return measured, planted


def afterwards(day: Day, poses: int) -> Conditions:
    """Machine and instrument as the day left them, for further poses from the first station."""
    last = day.conditions
    target = last.target[-1]
    now = Conditions.still(last.arm, target, day.machine.conditions(poses).more)
    if last.later:
        now.arm = last.later[1]
    if last.more.any():
        now.more[1::2] = last.more[1]
    if last.loose:
        rng = np.random.default_rng([47, day.machine.number])
        now.target = day.machine.target + last.loose * rng.standard_normal((poses, 1, 3))
    now.warmth += last.warmth[-1]
    now.turn[:], now.shift[:] = last.turn[0], last.shift[0]
    return now
