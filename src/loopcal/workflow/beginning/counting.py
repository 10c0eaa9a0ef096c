"""What a joint counts, where the nominal machine does not fit: its sign, its zero, both, and what
it shares with another joint.

The option --joints then states the columns as they have to be read.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np

from loopcal.errors import Code, InputError
from loopcal.files.recognition.joins import Fields
from loopcal.files.recognition.layouts import Layout
from loopcal.presentation.shown import enumerated, significant
from loopcal.units import from_si
from loopcal.workflow.beginning.searching import (
    CLEARLY,
    NOTHING,
    PLAUSIBLE,
    Counting,
    Machine,
    Understood,
    every_way,
)

SURE = 0.01
"""An explanation that leaves less needs no rivals."""
_LIKELIEST = 4
"""Ways to read the columns that are tried with joints counted in another way."""
_RIGHT_ANGLES = (np.pi / 2, -np.pi / 2, np.pi)


@dataclass(frozen=True, eq=False)
class Case:
    """What was read, and every way that was tried to understand it, the best first."""

    machine: Machine
    layouts: Sequence[Layout]
    fields: Fields
    ways: Sequence[Understood]

    @property
    def share(self) -> float:
        """The misfit of the best."""
        return self.ways[0].share if self.ways else float("inf")

    @property
    def as_read(self) -> str:
        """What follows the misfit of an explanation."""
        if not self.ways:
            return "; as read it fits nowhere"
        return f", as read by {percent(self.share)}"


@dataclass(frozen=True)
class Explanation:
    """What would explain the readings, with the misfit that it leaves."""

    share: float
    code: Code
    words: str
    remedy: str
    options: tuple[str, ...] = ()
    follows: str = ""

    def error(self) -> InputError:
        """As the refusal that it is."""
        error = InputError(self.words, code=self.code, remedy=self.remedy)
        return error.offering(*self.options).then(self.follows)


def turned_round(case: Case, count: int) -> Iterator[Explanation]:
    """So many joints that count the other way round."""
    for names in combinations(case.machine.joints, count):
        share, options = _counted(case, dict.fromkeys(names, Counting(sign=-1)))
        be = "counts" if count == 1 else "count"
        yield Explanation(
            share,
            "implausible-readings",
            f"{' and '.join(names)} {be} the other way round: with the sign reversed the nominal "
            f"machine misses the readings by {percent(share)} of their spread"
            f"{case.as_read}",
            "write -1 for it in a column direction of the robot's table, or correct the sign in "
            "the file, or state --joints",
            options,
        )


def exchanged(case: Case) -> Iterator[Explanation]:
    """Two joints under each other's columns."""
    joints = tuple(zip(case.machine.joints, case.machine.units, strict=True))
    for (one, unit_of_one), (other, unit_of_other) in combinations(joints, 2):
        if unit_of_one == unit_of_other:
            share, options = _counted(case, {one: Counting(), other: Counting()}, (one, other))
            yield Explanation(
                share,
                "implausible-readings",
                f"the columns of {one} and {other} are exchanged: the other way round the nominal "
                f"machine misses the readings by {percent(share)} of their spread"
                f"{case.as_read}",
                "state --joints, with the columns in the order of the machine",
                options,
            )


def displaced_zeros(case: Case, sign: int) -> Iterator[Explanation]:
    """One joint that counts from another zero, a right angle or two away; sign: -1 where it counts
    the other way round too."""
    for name in _with_zeros(case.machine):
        for zero in _RIGHT_ANGLES:
            degrees = round(np.degrees(zero))
            share, options = _counted(case, {name: Counting(sign, zero)})
            other_way = "" if sign > 0 else " and the other way round"
            yield Explanation(
                share,
                "implausible-readings",
                f"{name} counts from another zero{other_way}: with {degrees:+d} deg the nominal "
                f"machine misses the readings by {percent(share)} of their spread"
                f"{case.as_read}",
                f"add {degrees:+d} deg to its column, or to theta of this joint in the robot's "
                "table, or state --joints",
                options,
            )


def _with_zeros(machine: Machine) -> list[str]:
    """Joints that turn, without the first and the last of the machine: their zeros are those of the
    placement and the tool."""
    inner = zip(machine.joints[1:-1], machine.units[1:-1], strict=True)
    return [name for name, si in inner if si == "rad"]


def several(case: Case) -> Iterator[Explanation]:
    """Several joints that count from other zeros or the other way round: the best change of one
    joint after the other, begun with two at once where one alone leads nowhere."""
    machine = case.machine
    if case.share <= NOTHING or machine.units.count("rad") < 2:
        return
    zeros = dict.fromkeys(_with_zeros(machine), (0.0, *_RIGHT_ANGLES))
    changes = [
        {name: Counting(sign, zero)}
        for name, si in zip(machine.joints, machine.units, strict=True)
        for sign in (1, -1)
        for zero in zeros.get(name, (0.0,))
        if si == "rad"
    ]
    best = _descended(case, changes, ({},))
    if best.share > PLAUSIBLE:
        pairs = ({**one, **other} for one, other in combinations(changes, 2))
        best = _descended(case, changes, (pair for pair in pairs if len(pair) == 2))
    if CLEARLY * best.share > PLAUSIBLE:  # of so many trials one may fit by chance
        return
    no = Counting()
    names = enumerated([n for n in machine.joints if best.counting.get(n, no) != no])
    yield Explanation(
        best.share,
        "implausible-readings",
        f"{names} count from other zeros or the other way round: with {best.options[1]} the "
        f"nominal machine misses the readings by {percent(best.share)} of their spread"
        f"{case.as_read}",
        "correct theta and direction of these joints in the robot's table, or state --joints",
        best.options,
    )


@dataclass(frozen=True)
class _Trial:
    """What joints that count so leave, and the option that states it."""

    share: float
    options: tuple[str, ...]
    counting: Mapping[str, Counting]


def _descended(
    case: Case, changes: Sequence[Mapping[str, Counting]], starts: Iterable[Mapping[str, Counting]]
) -> _Trial:
    """From the best start, one change after the other for as long as the misfit falls."""

    def best(trials: Iterable[Mapping[str, Counting]]) -> _Trial:
        tried = (_Trial(*_counted(case, one), one) for one in trials)
        return min(tried, key=lambda one: one.share)

    now = best(starts)
    while now.share > SURE:
        after = best({**now.counting, **change} for change in changes)
        if not after.share < now.share:
            break
        now = after
    return now


def coupled(case: Case) -> Iterator[Explanation]:
    """One joint whose reading holds that of a neighbour too, as where the forearm keeps its angle
    to the floor while the upper arm moves."""
    machine = case.machine
    turning = [n for n, si in zip(machine.joints, machine.units, strict=True) if si == "rad"]
    for name, other in [*pairwise(turning), *pairwise(turning[::-1])]:
        for factor, words in ((1, "less"), (-1, "plus")):
            share, options = _counted(case, {name: Counting(other=other, factor=factor)})
            yield Explanation(
                share,
                "implausible-readings",
                f"{name} is read {words} {other}: with both together the nominal machine misses "
                f"the readings by {percent(share)} of their spread"
                f"{case.as_read}",
                "state --joints, with the joint as the sum of its columns",
                options,
            )


def _counted(
    case: Case, counting: Mapping[str, Counting], exchanged: Sequence[str] = ()
) -> tuple[float, tuple[str, ...]]:
    """The least misfit with joints counted in another way, and the option that states this.

    exchanged: two joints under each other's columns.
    """
    likeliest = [way.layout for way in case.ways] or list(case.layouts)
    layouts = list({id(layout): layout for layout in likeliest[:_LIKELIEST]}.values())
    if exchanged:
        order = list(range(len(case.machine.joints)))
        i, j = map(case.machine.joints.index, exchanged)
        order[i], order[j] = j, i
        layouts = [replace(one, joints=tuple(one.joints[k] for k in order)) for one in layouts]
    ways = every_way(case.machine, layouts, counting=counting)
    if not ways:
        return float("inf"), ()
    best = min(ways, key=lambda u: u.share)
    label = dict(zip(case.machine.joints, (f.label for f in best.layout.joints), strict=True))
    columns = []
    for name, of in zip(case.machine.joints, best.units, strict=True):
        one = counting.get(name, Counting())
        text = signed(label[name], one.sign)
        if one.zero:
            text += f"{from_si(one.zero, of):+.6g}"
        if one.other:
            text += f"{'+' if one.factor > 0 else '-'}{label[one.other]}"
        columns.append(text)
    return best.share, ("--joints", ",".join(columns))


def signed(label: str, sign: int) -> str:
    """A column as --joints states it, which may be counted the other way round already."""
    return label if sign > 0 else label[1:] if label.startswith("-") else f"-{label}"


def percent(share: float) -> str:
    """A share in words."""
    return f"{significant(100.0 * share, 2)} %"
