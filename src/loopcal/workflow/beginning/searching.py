"""Every way to understand the columns, tried on the placed nominal machine."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.mounted import KEPT, Bodies, bodies_of, evenly, extent
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.files.machines.registry import machine_type
from loopcal.files.recognition.fields import names_of
from loopcal.files.recognition.layouts import Layout
from loopcal.files.recognition.meanings import Meaning, joint_units, meanings
from loopcal.files.recognition.robots import Robot
from loopcal.mechanisms.frame import ChainFrame, Frame, Values, forward_kinematics
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.simulation.closing import close_loops, reachable
from loopcal.units import to_si

PLAUSIBLE = 0.1
"""What another meaning must leave at most to speak against a stated unit."""
# Wrong units are wrong by factors of 10 to 1000 (docs/decisions/0056).
CLEARLY = 3.0
"""A meaning is decided if every other one leaves so many times its misfit."""
NOTHING = 0.3
"""A misfit of this share of the spread of the readings, or more: the machine explains nothing."""
FAR = 10.0
"""A meaning that fits so many times worse on a few poses is not tried on more."""
# Few poses drop what is wrong by factors; more decide among the rest.
_SAMPLE, _FEW = 120, 40
_AS_LARGE = 8.0
"""Between mm and cm lies a factor of 10."""
_PROPORTION = 4.0
"""A machine is no longer, and no shorter, than so many times its travel."""
_Way = TypeVar("_Way")


@dataclass(frozen=True, eq=False)
class Understood:
    """The columns with their meaning.

    joints: quantity -> readings [SI]; kinds, units: SI unit of each, and that of its column;
    seen: the instruments; remarks: what the data decided, in words; others: the meanings that fit
    next best, of instruments that have several.
    """

    layout: Layout
    joints: dict[str, Array]
    kinds: tuple[str, ...]
    units: tuple[str, ...]
    seen: tuple[Meaning, ...]
    bodies: Bodies
    remarks: tuple[str, ...] = ()
    others: tuple[Meaning, ...] = ()

    @property
    def share(self) -> float:
        """The largest misfit of its instruments."""
        return max(m.share for m in self.seen)

    @property
    def words(self) -> tuple[str, ...]:
        """All units and orders."""
        return (self.joint_words, *(w for meaning in self.seen for w in meaning.words))

    @property
    def joint_words(self) -> str:
        """The units of the joints, those that slide in units of length."""
        clauses = []
        columns = list(zip(self.layout.joints, self.kinds, self.units, strict=True))
        kinds = dict.fromkeys((kind, of) for _, kind, of in columns)
        for kind, of in sorted(kinds, key=lambda one: one[0] != "rad"):  # what turns comes first
            some = [f for f, *others in columns if others == [kind, of]]
            clauses.append(
                f"the {'joints' if kind == 'rad' else 'slides'} {names_of(some)} in {of}"
            )
        return "; ".join(clauses)


@dataclass(frozen=True)
class Counting:
    """How a joint is counted: sign * reading + zero [rad] + factor * reading of another joint."""

    sign: int = 1
    zero: float = 0.0
    other: str = ""
    factor: int = 0


@dataclass(frozen=True, eq=False)
class Machine:
    """The nominal machine as far as its joints move it.

    frame: (x, p) -> T_base_body of a parallel machine; None for a mechanism with a chain;
    dimension: 2 for a machine that moves in a plane.
    """

    mechanism: Mechanism
    joints: tuple[str, ...]
    frame: Callable[[Values, Values], Frame] | None = None
    dimension: int = 3

    @property
    def units(self) -> tuple[str, ...]:
        """SI unit of each joint."""
        return tuple(self.mechanism.quantities[name] for name in self.joints)

    def bodies(self, joints: dict[str, Array]) -> Bodies:
        """Where its body stands in every pose."""
        nominal = {p.name: p.nominal for p in self.mechanism.parameters}
        count = len(next(iter(joints.values())))
        frame = self.frame
        if frame is None:
            return bodies_of(ChainFrame(self.mechanism.chain, joints, nominal), count)
        names = self.mechanism.tape.quantities
        home = self.mechanism.home
        x = np.array([joints.get(q, np.full(count, home.get(q, 0.0))) for q in names])
        closed = self._closed(x, np.array(list(nominal.values())))
        T = forward_kinematics(lambda x: frame(x, nominal), closed.T, names, each=True)
        return Bodies(T[:, :3, :3], T[:, :3, 3])

    def _closed(self, x: Array, parameters: Array) -> Array:
        """All quantities (k, N) where the loops close from here, NaN elsewhere; in another unit a
        few poses close by chance, and none counts."""
        names = self.mechanism.tape.quantities
        poses = tuple(map(str, range(x.shape[1])))
        unread = [q for q in names if q not in self.joints]
        none = np.zeros((0, len(poses)))
        at = reachable(self.mechanism, parameters, x, none, unread)
        closed = np.full(x.shape, np.nan)
        if at.sum() >= KEPT * np.isfinite(x).all(axis=0).sum():
            some = tuple(np.array(poses)[at])
            closed[:, at] = close_loops(
                self.mechanism, parameters, x[:, at], none[:, at], unread, some
            )
        return closed


def machine_of(robot: Robot, file: str) -> Machine:
    """The machine of a robot's table; file: what messages call it."""
    mechanism = mechanism_from_data(dict(robot.table), file)
    if not robot.unread:
        return Machine(mechanism, tuple(mechanism.joints))
    made = machine_type(robot.table["type"]).make()
    return Machine(mechanism, robot.names, made.frame, made.dimension)


def every_way(
    machine: Machine,
    layouts: Sequence[Layout],
    *,
    as_stated: bool = True,
    mixed: bool = False,
    counting: Mapping[str, Counting] = MappingProxyType({}),
) -> list[Understood]:
    """All combinations of meanings, judged on some of the poses; of each instrument the best and
    those that fit about as well. mixed: turning joints may be in units of their own; counting: of
    joints that do not count as the machine does."""
    ways = []
    for layout in layouts:
        for units in joint_units(layout.joints, machine.units, as_stated=as_stated, mixed=mixed):
            joints = {
                name: to_si(f.values, of)
                for name, f, of in zip(machine.joints, layout.joints, units, strict=True)
            }
            moved = dict(joints)
            for name, one in counting.items():
                moved[name] = one.sign * joints[name] + one.zero
                if one.other:
                    moved[name] = moved[name] + one.factor * joints[one.other]
            bodies = machine.bodies(moved)
            options, others = [], list[Meaning]()
            for seen in layout.seen:
                some, few = evenly(seen.rows, _SAMPLE), evenly(seen.rows, _FEW)
                some_meanings = meanings(seen, as_stated=as_stated)
                if counting or mixed:  # one of many trials
                    some_meanings = (m for m in some_meanings if as_large(m, bodies))
                    options.append(_fitting(some_meanings, bodies, few, 1)[:1])
                    continue
                tried = _fitting(some_meanings, bodies, few, 1)
                others += tried[1:2]
                # 1e-12 keeps all meanings of readings that the machine fits exactly.
                near = [m for m in tried if m.share < FAR * tried[0].share + 1e-12]
                tried = _fitting(near, bodies, some, 4)
                tried = [m for m in tried if m.share < CLEARLY * tried[0].share + 1e-12]
                if tried and tried[0].share <= PLAUSIBLE:
                    # A turntable fits in every unit: its axes fix no length.
                    travels = [extent(np.reshape(m.position, (len(m.position), -1))) for m in tried]
                    tried = in_proportion(machine, tried, travels)
                options.append(tried)
            if not all(options):
                continue
            options, fitting = _belonging(options, layout)
            best = tuple(o[0] for o in options)
            first = Understood(
                fitting, joints, machine.units, units, best, bodies, others=tuple(others)
            )
            ways.append(first)
            for i, tied in enumerate(options):
                for other in tied[1:]:
                    seen_so = (*first.seen[:i], other, *first.seen[i + 1 :])
                    ways.append(replace(first, seen=seen_so))
    return ways


def closes(machine: Machine, layouts: Sequence[Layout]) -> bool:
    """Whether the machine can stand as its joints read in most poses, in some units."""
    for layout in layouts:
        for units in joint_units(layout.joints, machine.units):
            columns = zip(machine.joints, layout.joints, units, strict=True)
            bodies = machine.bodies({name: to_si(f.values, of) for name, f, of in columns})
            if bodies.complete.any():
                return True
    return False


def as_large(meaning: Meaning, bodies: Bodies) -> bool:
    """Whether the readings move about as far as the body does; units differ by larger factors."""
    if meaning.position.ndim != 2:
        return True
    read, moved = extent(meaning.position), bodies.extent
    return moved < _AS_LARGE * read and read < _AS_LARGE * moved


def in_proportion(machine: Machine, ways: list[_Way], travels: Iterable[float]) -> list[_Way]:
    """Those that travel [m] about as far as the machine is long; all where none does."""
    size = sum(abs(p.nominal) for p in machine.mechanism.parameters if p.unit == "m")
    some = [size < _PROPORTION * moved < _PROPORTION**2 * size for moved in travels]
    return [way for way, fits in zip(ways, some, strict=True) if fits] or ways


def _belonging(options: list[list[Meaning]], layout: Layout) -> tuple[list[list[Meaning]], Layout]:
    """Without what the machine does not move at all, where it explains another instrument: these
    columns are velocities, forces or of another body. A station's columns are no such."""
    least = min(o[0].share for o in options)
    kept = [o for o in options if o[0].share < NOTHING or o[0].seen.station]
    if least > PLAUSIBLE or len(kept) == len(options):
        return options, layout
    gone = [o[0].seen for o in options if o not in kept]
    columns = tuple(f for s in gone for f in (*s.position, *s.turned, *s.sds))
    seen = tuple(o[0].seen for o in kept)
    return kept, replace(layout, seen=seen, ignored=(*layout.ignored, *columns))


def _fitting(
    some: Iterable[Meaning], bodies: Bodies, index: NDArray[np.intp], rounds: int
) -> list[Meaning]:
    """Those that have a fit, the best first."""
    tried = (m.fitted(bodies, index, rounds) for m in some)
    return sorted((m for m in tried if m.fit is not None), key=lambda m: m.share)
