"""The one way to understand the files that the nominal machine fits; or a question to the user."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.estimation.mounted import Bodies, bodies_of, own_coordinates
from loopcal.files.recognition.fields import Fields
from loopcal.files.recognition.layouts import Layout
from loopcal.mechanisms.frame import ChainFrame
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.presentation.rounding import significant
from loopcal.units import to_si
from loopcal.workflow.beginning.meanings import Meaning, joint_units, meanings

Array = NDArray[np.float64]
NOTHING = 0.3
"""A misfit of this share of the spread of the readings, or more: the machine explains nothing."""
PLAUSIBLE = 0.1
"""What another meaning must leave at most to speak against a stated unit."""
CLEARLY = 3.0
"""A meaning is decided if every other one leaves so many times its misfit."""
COMPUTED = 0.02
"""Points that lie so near the machine's own nominal coordinates were computed from its joints."""
FAR = 10.0
"""A meaning that fits so many times worse on a few poses is not tried on more."""
_SAMPLE, _FEW, _SHIFTS = 120, 40, (1, -1, 2, -2, 3, -3)

Ask = Callable[[str, Sequence[str]], int]
"""Asks which answer is right and returns its number, counted from 0."""


@dataclass(frozen=True, eq=False)
class Understood:
    """The columns with their meaning.

    joints: quantity -> readings [SI]; units: SI unit -> unit of the joint columns; seen: the
    instruments; remarks: what the data decided, in words.
    """

    layout: Layout
    joints: dict[str, Array]
    units: dict[str, str]
    seen: tuple[Meaning, ...]
    bodies: Bodies
    remarks: tuple[str, ...] = ()

    @property
    def share(self) -> float:
        """The largest misfit of its instruments."""
        return max(m.share for m in self.seen)

    @property
    def words(self) -> tuple[str, ...]:
        """All units and orders."""
        joints = self.layout.joints
        names = ", ".join(
            f.heading.text if f.heading else f"column {f.position + 1}" for f in joints
        )
        told = [f"the joints {names} in {self.units['rad']}"]
        for meaning in self.seen:
            told += meaning.words
        return tuple(told)


@dataclass(frozen=True, eq=False)
class Machine:
    """The nominal machine as far as its joints move it: a mechanism with a chain."""

    mechanism: Mechanism
    joints: tuple[str, ...]

    @property
    def units(self) -> tuple[str, ...]:
        """SI unit of each joint."""
        return tuple(self.mechanism.quantities[name] for name in self.joints)

    def bodies(self, joints: dict[str, Array]) -> Bodies:
        """Where its body stands in every pose."""
        nominal = {p.name: p.nominal for p in self.mechanism.parameters}
        count = len(next(iter(joints.values())))
        return bodies_of(ChainFrame(self.mechanism.chain, joints, nominal), count)


def understood(
    machine: Machine, layouts: Sequence[Layout], fields: Fields, ask: Ask | None
) -> Understood:
    """The meaning of the columns that the placed nominal machine fits clearly best.

    ask: asks where several fit; None refuses. Raises InputError where none fits, several do, a
    stated unit contradicts the readings, or rows do not belong together.
    """
    found = sorted(_every(machine, layouts), key=lambda u: u.share)
    if not found or not found[0].share <= PLAUSIBLE:
        _refuse_stated(machine, layouts, found)
    if not found:
        raise InputError(
            "the readings determine no place of the instrument in any of all units and orders",
            code="too-few-poses",
            remedy="measure at least 5 poses that differ in every joint",
        )
    best = found[0]
    if fields.by_order or not best.share <= NOTHING:
        for meaning in found if not best.share <= NOTHING else found[:1]:
            _refuse_shifted(meaning)
    if not best.share <= PLAUSIBLE:
        _refuse_reversed(machine, layouts, best.share)
    if not best.share <= NOTHING:
        raise _fits_nothing(best)
    rivals = [u for u in found[1:] if u.share < min(CLEARLY * best.share, NOTHING)]
    if rivals and best.share > 1e-9:
        best = _asked([best, *rivals], ask)
    return _told(best)


def _every(
    machine: Machine,
    layouts: Sequence[Layout],
    *,
    as_stated: bool = True,
    turned_round: Collection[str] = (),
) -> list[Understood]:
    """All combinations of meanings, judged on some of the poses; of each instrument the best and
    those that fit about as well. turned_round: joints that are read with the other sign."""
    found = []
    for layout in layouts:
        count = len(layout.joints[0].values)
        some, few = (
            np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.intp))
            for most in (_SAMPLE, _FEW)
        )
        for units in joint_units(layout.joints, machine.units, as_stated=as_stated):
            joints = {
                name: to_si(f.values, f.unit if f.unit and as_stated else units[si])
                for name, f, si in zip(machine.joints, layout.joints, machine.units, strict=True)
            }
            moved = {n: -q if n in turned_round else q for n, q in joints.items()}
            bodies = machine.bodies(moved)
            options = []
            for seen in layout.seen:
                tried = _fitting(meanings(seen, as_stated=as_stated), bodies, few, 1)
                near = [m for m in tried if m.share < FAR * tried[0].share + 1e-12]
                tried = _fitting(near, bodies, some, 4)
                options.append([m for m in tried if m.share < CLEARLY * tried[0].share + 1e-12])
            if not all(options):
                continue
            first = Understood(layout, joints, units, tuple(o[0] for o in options), bodies)
            found.append(first)
            for i, its in enumerate(options):
                for other in its[1:]:
                    seen_so = (*first.seen[:i], other, *first.seen[i + 1 :])
                    found.append(replace(first, seen=seen_so))
    return found


def _fitting(
    some: Iterable[Meaning], bodies: Bodies, index: NDArray[np.intp], rounds: int
) -> list[Meaning]:
    """Those that have a fit, the best first."""
    tried = (m.fitted(bodies, index, rounds) for m in some)
    return sorted((m for m in tried if m.fit is not None), key=lambda m: m.share)


def _asked(rivals: Sequence[Understood], ask: Ask | None) -> Understood:
    """The choice of the user among meanings that fit about as well.

    Raises InputError with all of them where nobody can be asked.
    """
    common = set.intersection(*(set(u.words) for u in rivals))
    answers = [
        f"{'; '.join(w for w in u.words if w not in common) or u.layout.how} "
        f"(misfit {significant(100.0 * u.share, 2)} % of the spread of the readings)"
        for u in rivals
    ]
    if ask is not None:
        return rivals[ask("The readings fit in several ways. Which is right?", answers)]
    raise InputError(
        f"the readings fit in {len(rivals)} ways: {' -- or -- '.join(answers[:4])}",
        code="unknown-unit",
        remedy='state units in the headers ("x [mm]", "J1 [deg]"), or name the columns',
    )


def _refuse_stated(
    machine: Machine, layouts: Sequence[Layout], found: Sequence[Understood]
) -> None:
    """Raise InputError where the readings contradict a unit that a header states."""
    fields = [f for lay in layouts for s in lay.seen for f in (*lay.joints, *s.position, *s.turned)]
    if not any(f.unit for f in fields):
        return
    free = sorted(_every(machine, layouts, as_stated=False), key=lambda u: u.share)
    stated = found[0].share if found else float("inf")
    if free and free[0].share <= PLAUSIBLE and CLEARLY * free[0].share < stated:
        before = set(found[0].words) if found else set()
        other = "; ".join(w for w in free[0].words if w not in before) or "another unit"
        raise InputError(
            f"the units in the headers contradict the readings: the nominal machine fits with "
            f"{other}, and misses them by {significant(100.0 * stated, 2)} % of their spread as "
            "stated",
            code="wrong-unit",
            remedy="correct the unit in the header, or remove it to have it inferred",
        )


def _refuse_reversed(machine: Machine, layouts: Sequence[Layout], share: float) -> None:
    """Raise InputError where one or two joints count the other way round."""
    pairs = combinations(machine.joints, 2)
    for names in (*((name,) for name in machine.joints), *pairs):
        found = _every(machine, layouts, turned_round=names)
        best = min((u.share for u in found), default=float("inf"))
        if best <= PLAUSIBLE and CLEARLY * best < share:
            be = "counts" if len(names) == 1 else "count"
            raise InputError(
                f"{' and '.join(names)} {be} the other way round: with the sign reversed the "
                f"nominal machine misses the readings by {significant(100.0 * best, 2)} % of their "
                f"spread, as read by {significant(100.0 * share, 2)} %",
                code="implausible-readings",
                remedy="write -1 for it in a column direction of the robot's table, or correct "
                "the sign in the file",
            )


def _fits_nothing(best: Understood) -> InputError:
    return InputError(
        "the nominal machine does not describe these readings: in the best of all units and orders "
        f"it misses them by {significant(100.0 * best.share, 2)} % of their spread",
        code="implausible-readings",
        remedy="check the robot (URDF, Denavit-Hartenberg table and its convention), the signs and "
        "zeros of the joints, and that joints and instrument are of the same poses",
    )


def _refuse_shifted(best: Understood) -> None:
    """Raise InputError where rows that were joined by order fit better some rows apart."""
    count = len(best.bodies.origins)
    every = np.arange(count)
    for meaning in best.seen:
        whole = meaning.fitted(best.bodies).share
        for shift in _SHIFTS:
            rows, moved = (
                (every[:-shift], every[shift:]) if shift > 0 else (every[-shift:], every[:shift])
            )
            if len(rows) < 10:
                continue
            bodies = Bodies(best.bodies.rotations[rows], best.bodies.origins[rows])
            turns = None if meaning.turns is None else meaning.turns[moved]
            displaced = replace(meaning, position=meaning.position[moved], turns=turns)
            share = displaced.fitted(bodies).share
            if CLEARLY * share < whole and share < NOTHING:
                where = "late" if shift > 0 else "early"
                plural = "s" if abs(shift) > 1 else ""
                raise InputError(
                    f"the rows of the instrument stand {abs(shift)} row{plural} too {where} beside "
                    f"those of the joints (misfit {significant(100 * whole, 2)} % of the spread as "
                    f"they stand, {significant(100 * share, 2)} % if moved)",
                    code="mismatched-poses",
                    remedy="give both files a column of pose ids, or remove the row too many",
                )


def _told(best: Understood) -> Understood:
    """With the fits of all poses, the computed instruments left out, and what the data decided."""
    seen = tuple(m.fitted(best.bodies) for m in best.seen)
    told = []
    kept = []
    for meaning in seen:
        names = ", ".join(f.heading.text if f.heading else "?" for f in meaning.seen.position)
        if meaning.seen.kind == "point" and meaning.fit is not None:
            off = own_coordinates(best.bodies, meaning.position)
            if off < COMPUTED * meaning.fit.spread:
                size = f"{significant(1e3 * off, 2)} mm"
                told.append(
                    f"{names} equal the nominal machine's own coordinates to {size}: computed by "
                    "the controller, not measured"
                )
                if len(seen) > 1:
                    continue
        kept.append(meaning)
    return replace(best, seen=tuple(kept or seen), remarks=tuple(told))
