"""What happens to a machine, to its instrument or to the file on one day of its life."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analyses.gauntlet_truth import Arm, Array
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


@dataclass(frozen=True)
class Kind:
    """A kind of day.

    event: before the measurement; names: what an answer must speak of to have named it, a regular
    expression, where no parameter does; tamper: afterwards, in the file; happens: to which
    machines; named: whether it has a name; column: whether that of its column belongs to it.
    """

    name: str
    event: Event | None = None
    names: str = ""
    tamper: Event | None = None
    happens: Callable[[Machine], bool] = lambda machine: True
    named: bool = True
    column: bool = False


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


def _zero(day: Day, rng: Rng) -> Planted:
    """A joint behind the first and ahead of the last of an arm: station and tool hide those."""
    last = len(day.machine.joints) - day.machine.turns
    j = int(rng.integers(2, last + 1))
    size = 0.05 * DEGREE * rng.choice([-1.0, 1.0])
    day.conditions.arm = rezeroed(day.conditions.arm, j, size)
    return Planted("zero", size, "rad", _zeros(day, j))


def _tool(day: Day, rng: Rng) -> Planted:
    vector = 1e-3 * np.array([4.0, -6.0, 3.0])[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
    day.conditions.target = day.conditions.target + vector
    words = "(" + ", ".join(f"{1e3 * v:+.0f}" for v in vector) + ") mm"
    parameters = ("tool", "tool_x", "tool_y", "tool_z")
    return Planted("tool", float(np.linalg.norm(vector)), "m", parameters, words=words)


def _slip(day: Day, rng: Rng) -> Planted:
    row, size = _row(day, rng), rng.uniform(5e-4, 1e-3)
    day.conditions.target[row:] += size * _direction(rng)
    return Planted("slip", size, "m", ("tool", "tool_x", "tool_y", "tool_z"), row + 1)


def _warming(day: Day, rng: Rng) -> Planted:
    size = rng.uniform(1e-4, 2e-4)
    day.conditions.drift += np.linspace(0.0, size, len(day.q))[:, None] * _direction(rng)
    return Planted("warming", size, "m")


def _warm_machine(day: Day, rng: Rng) -> Planted:
    kelvin = rng.uniform(8.0, 16.0)
    day.conditions.warmth += np.linspace(0.0, kelvin, len(day.q))
    size = kelvin * day.conditions.arm.expansion
    return Planted("warm machine", size, "1", words=f"{kelvin:.0f} K")


def _payload(day: Day, rng: Rng) -> Planted:
    more = 5.0
    arm = day.conditions.arm
    assert isinstance(arm, Arm)
    day.conditions.arm = replace(arm, tool_mass=arm.tool_mass + more)
    return Planted("payload", more, "kg")


def _bend(day: Day, rng: Rng) -> Planted:
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


def _loose(day: Day, rng: Rng) -> Planted:
    day.conditions.loose = 3e-4
    day.conditions.target += day.conditions.loose * rng.standard_normal((len(day.q), 3))
    return Planted("loose flange", day.conditions.loose, "m")


def _rows_shifted(day: Day, rng: Rng) -> Planted:
    day.joints, day.points, day.rows = day.joints[:-1], day.points[1:], day.rows[:-1]
    return Planted("rows shifted", 1.0, "rows")


def _one_off(day: Day, rng: Rng) -> Planted:
    row = int(rng.integers(len(day.q)))
    day.points[row] += 0.02 * _direction(rng)
    return Planted("one pose off", 0.02, "m", pose=row + 1)


def _copied(day: Day, rng: Rng) -> Planted:
    again = np.sort(rng.permutation(len(day.q))[: len(day.q) // 3])
    rows = np.append(np.arange(len(day.q)), again)
    day.joints, day.points, day.rows = day.joints[rows], day.points[rows], rows
    return Planted("copied rows", float(len(again)), "rows")


def _unit(day: Day, rng: Rng) -> Planted:
    column = int(rng.integers(3))
    day.points[:, column] /= 25.4
    return Planted("unit", 25.4, "1", ("xyz"[column],))


def _sign(day: Day, rng: Rng) -> Planted:
    j = int(rng.integers(2, len(day.machine.joints)))
    day.joints[:, j - 1] *= -1.0
    return Planted("sign", 2.0, "1", _zeros(day, j))


CLEAN = "clean"
ALONG = r"drift|warm|temperature|over the (whole )?run"
LOAD = r"payload|\bload|weight|heavier|gravity"
KINDS = {
    kind.name: kind
    for kind in (
        Kind(CLEAN, named=False),
        Kind("zero", _zero),
        Kind("tool", _tool, r"\btool|target|reflector|mount(ed|ing)", happens=lambda m: m.turns),
        Kind("slip", _slip, names=r"slip|from pose|since pose"),
        Kind("warming", _warming, names=ALONG),
        Kind("payload", _payload, LOAD, happens=lambda m: m.sags),
        Kind("bend", _bend),
        Kind("rows shifted", tamper=_rows_shifted, names=r"\brows?\b"),
        Kind("one pose off", names=r"pose", tamper=_one_off),
        Kind("loose flange", _loose, named=False),
        Kind("warm machine", _warm_machine, names=rf"{ALONG}|scale|expan"),
        Kind("copied rows", tamper=_copied, names=r"cop(y|ies|ied)|same row|repeated row|twice"),
        Kind("unit", tamper=_unit, names=r"\bunits?\b|\binch|25\.4", column=True),
        Kind("sign", tamper=_sign, names=r"\bsign|revers|other way", column=True),
    )
}
PLANTED = tuple(name for name in KINDS if name != CLEAN)


def kinds(machine: Machine, days: int) -> list[str]:
    """What happens on each day of a machine: every second day nothing, the rest in turn."""
    applicable = [k for k in PLANTED if KINDS[k].happens(machine)]
    first = 5 * machine.number  # ten days bring five changes: the next machine goes on with others
    return [
        CLEAN if day % 2 == 0 else applicable[(first + day // 2) % len(applicable)]
        for day in range(days)
    ]


def made(machine: Machine, day: int, kind: str) -> tuple[Day, Planted]:
    """One day's file and what is true of it; the same for these numbers every time."""
    rng = np.random.default_rng([43, machine.number, day])
    poses = int(rng.integers(20, 41))
    q = machine.posed(poses, rng)
    measured = Day(machine, q, machine.conditions(poses))
    planted = Planted(kind)
    if event := KINDS[kind].event:
        planted = event(measured, rng)
    measured.rows = np.arange(poses)
    measured.joints, measured.points = machine.measured(q, measured.conditions, rng)
    if tamper := KINDS[kind].tamper:
        planted = tamper(measured, rng)
    return measured, planted


def afterwards(day: Day, poses: int) -> Conditions:
    """Machine and instrument as the day left them, for further poses."""
    last = day.conditions
    target = np.tile(last.target[-1], (poses, 1))
    if last.loose:
        rng = np.random.default_rng([47, day.machine.number])
        target = day.machine.target + last.loose * rng.standard_normal((poses, 3))
    return Conditions(
        last.arm,
        target,
        np.zeros((poses, 3)),
        np.full(poses, last.warmth[-1]),
        day.machine.conditions(poses).more,
    )
