"""What one pose is measured with: instruments that are read, and things that touch in it.

An instrument reads wherever it sees its target. Where balls touch, a ball sits in a socket or two
hands hold one part, nothing is read: the gap is closed, and only some joints make it so. So the
joints of such poses are moved until it is, by as little as each step allows and within limits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.plan_settings import Span
from loopcal.mechanisms.mechanism import PIXELS, Family, Mechanism
from loopcal.simulation.simulate import moved_to_close

Mask = NDArray[np.bool_]


def touching(mechanism: Mechanism) -> tuple[Family, ...]:
    """What joints alone can close: contacts, planes, sockets and held parts, none of which reads
    anything."""
    implied = mechanism.implied.keys() - {*mechanism.turns}
    if mechanism.tree is None:
        return ()
    return tuple(f for f in mechanism.families if f.readings and implied >= {*f.readings})


def gaps_of(mechanism: Mechanism) -> frozenset[str]:
    """The gaps and turns of all that touches."""
    return frozenset(q for family in touching(mechanism) for q in family.readings)


def _direct(mechanism: Mechanism) -> tuple[Family, ...]:
    """Contacts and images. The joints determine each reading of these, by one loop equation."""
    if mechanism.tree is None:
        return ()
    return (*touching(mechanism), *(f for f in mechanism.families if f.form == PIXELS))


def without_direct(mechanism: Mechanism) -> Mechanism:
    """The same machine without contacts and images: joints and boards may be anywhere."""
    direct = _direct(mechanism)
    if not direct:
        return mechanism
    loops = {loop for family in direct for loop in family.loops}
    kept = [i for i, loop in enumerate(mechanism.tape.loops) if loop not in loops]
    readings = {q: 0.0 for family in direct for q in family.readings}
    return replace(
        mechanism,
        tape=mechanism.tape.only(kept),
        body=None,
        families=tuple(f for f in mechanism.families if f not in direct),
        outputs=tuple(q for q in mechanism.outputs if q not in readings),
        implied={**mechanism.implied, **readings},
    )


def direct_readings(mechanism: Mechanism, closed: Dataset) -> dict[str, Array]:
    """Gap or pixel -> (N,) [SI] what the joints make of it, everything else closed."""
    direct = _direct(mechanism)
    if not direct:
        return {}
    # Every loop has the slope -1 by its own reading.
    zero = {q: np.zeros(len(closed)) for family in direct for q in family.readings}
    off = mechanism.loop_values({**closed.readings, **zero})
    pairs = (zip(f.loops, f.readings, strict=True) for f in direct)
    return {reading: off[loop] for one in pairs for loop, reading in one}


def occasions(mechanism: Mechanism, measured: Dataset | None) -> tuple[tuple[str, ...], ...]:
    """The instruments of one pose, for each kind of pose: as in poses already measured.

    Of kinds with the same contacts that is the one with most instruments: one of them may not have
    been seen in some poses. Before anything was measured all that read go together, and with each
    contact.
    """
    families = mechanism.families
    contacts = {f.name for f in touching(mechanism)}
    if measured is None or not families:
        read = tuple(f.name for f in families if f.name not in contacts)
        each = tuple((f.name, *read) for f in families if f.name in contacts)
        return (read, *each) if read else each
    seen = np.array([_seen(mechanism, f, measured) for f in families])
    kinds = {frozenset(f.name for f, s in zip(families, one, strict=True) if s) for one in seen.T}
    most = [
        a for a in kinds if a and not any(a < b and a & contacts == b & contacts for b in kinds)
    ]
    ordered = [tuple(f.name for f in families if f.name in kind) for kind in most]
    return tuple(sorted(ordered, key=lambda kind: [f.name in kind for f in families], reverse=True))


def _seen(mechanism: Mechanism, family: Family, data: Dataset) -> Mask:
    """(N,) whether a family is read; gaps without a column are."""
    silent = family in touching(mechanism)
    columns = [q for q in family.readings if silent or q not in mechanism.implied]
    if not columns or (silent and not any(q in data.readings for q in columns)):
        return np.ones(len(data), dtype=bool)
    seen = [np.isfinite(data.readings[q]) for q in columns if q in data.readings]
    return np.asarray(np.any(seen, axis=0)) if seen else np.zeros(len(data), dtype=bool)


def serving(mechanism: Mechanism, closed: Dataset) -> tuple[tuple[str, ...], ...]:
    """The instruments that serve each pose; none where all serve every one."""
    seen = [(f.name, _seen(mechanism, f, closed)) for f in mechanism.families]
    if all(of.all() for _, of in seen):
        return ()
    return tuple(tuple(name for name, of in seen if of[i]) for i in range(len(closed)))


def served(mechanism: Mechanism, kinds: tuple[tuple[str, ...], ...], count: int) -> Mask:
    """(F, N) which family each of so many poses serves: two poses of every kind in turn."""
    at = np.arange(count) // 2 % max(len(kinds), 1)
    of_kind = np.array([[f.name in kind for kind in kinds] for f in mechanism.families], dtype=bool)
    return of_kind[:, at] if kinds else np.ones((len(mechanism.families), count), dtype=bool)


def stated_for(mechanism: Mechanism, poses: Dataset) -> Mask:
    """(F, N) which family stated poses serve: every one, but contacts with a blank gap."""
    contacts = touching(mechanism)
    return np.array(
        [
            _seen(mechanism, f, poses) if f in contacts else np.ones(len(poses), dtype=bool)
            for f in mechanism.families
        ]
    ).reshape(len(mechanism.families), len(poses))


def blanks(mechanism: Mechanism, serves: Mask) -> dict[str, Mask]:
    """Reading -> (N,) where it is blank, of families that some poses do not serve."""
    return {
        q: ~serves[i]
        for i, family in enumerate(mechanism.families)
        for q in family.readings
        if not serves[i].all()
    }


def blanked(data: Dataset, blank: Mapping[str, Mask]) -> Dataset:
    """The data without readings that are blank."""
    some = {q: np.where(b, np.nan, data.readings[q]) for q, b in blank.items()}
    return data.with_readings(some) if some else data


def brought_together(
    mechanism: Mechanism,
    poses: Dataset,
    serves: Mask,
    spans: Mapping[str, Span | tuple[Array, Array]],
) -> tuple[Dataset, Mask]:
    """The poses, their joints moved within spans [SI] so that what they serve touches; and whether
    it does, (N,). Where joints have no span these alone move.
    """
    families = touching(mechanism)
    rows = [mechanism.families.index(f) for f in families]
    every, closes = np.ones(len(poses)), np.ones(len(poses), dtype=bool)
    readings = {q: values.copy() for q, values in poses.readings.items()}
    for kind in np.unique(serves[rows].T, axis=0):
        loops = {loop for f, one in zip(families, kind, strict=True) if one for loop in f.loops}
        if not loops:
            continue
        some = np.flatnonzero((serves[rows] == kind[:, None]).all(axis=0))
        kept = [i for i, loop in enumerate(mechanism.tape.loops) if loop in loops]
        tape = mechanism.tape.only(kept)
        alone = replace(mechanism, tape=tape, families=(), outputs=(), body=None)
        inputs = frozenset().union(*tape.depends_on("quantity"))
        moving = [q for q in mechanism.joints if q in inputs]
        if loose := [q for q in moving if q not in poses.readings]:
            free = dict.fromkeys(loose, (-np.inf * every, np.inf * every))
        else:
            free = {q: (spans[q][0] * every, spans[q][1] * every) for q in moving if q in spans}
        free = {q: (low[some], high[some]) for q, (low, high) in free.items()}
        moved, ok = moved_to_close(alone, poses.take(some), free)
        closes[some] = ok
        for q, values in moved.items():
            readings.setdefault(q, np.zeros(len(poses)))[some] = values
    return poses.with_readings(readings, units=mechanism.quantities), closes
