"""Why the nominal machine does not fit the readings: what would explain them, and what to do."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, combinations, islice, permutations, product

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.estimation.faults.repairs import set_apart
from loopcal.files.recognition.fields import Field, names_of
from loopcal.files.recognition.joins import Fields
from loopcal.files.recognition.layouts import FEWEST, Seen
from loopcal.files.recognition.meanings import ANGLES, LENGTHS, Meaning, positions, turned_by
from loopcal.files.recognition.shots import MOST_TARGETS
from loopcal.presentation.shown import with_unit
from loopcal.units import unit
from loopcal.workflow.beginning.counting import (
    SURE,
    Case,
    Explanation,
    coupled,
    displaced_zeros,
    exchanged,
    percent,
    several,
    signed,
    turned_round,
)
from loopcal.workflow.beginning.counts import reads_counts
from loopcal.workflow.beginning.misplaced_rows import ONE_POSE, reordered
from loopcal.workflow.beginning.searching import (
    CLEARLY,
    NOTHING,
    PLAUSIBLE,
    Understood,
    as_large,
    every_way,
)

_BRACKETS = re.compile(r"(?P<name>[^\[(]+)[\[(](?P<unit>[^\])]+)[\])]")
_MIRROR = np.array([-1.0, 1.0, 1.0])
_SHIFTS = (1, -1, 2, -2, 3, -3)
_FEW = 40
"""Poses that one coordinate is tried on."""
# Twelve points are 36 equations for the nine numbers of station and target.
_BLOCK, _TOGETHER = 12, 0.05
"""So many consecutive poses are fitted alone; they then belong together if they leave this."""


def contradiction(case: Case) -> Explanation | None:
    """Where the readings contradict a unit that a header states."""
    fields = [
        f for lay in case.layouts for s in lay.seen for f in (*lay.joints, *s.position, *s.turned)
    ]
    if not any(f.unit for f in fields):
        return None
    free = sorted(every_way(case.machine, case.layouts, as_stated=False), key=lambda u: u.share)
    stated = case.share
    if not free or free[0].share > PLAUSIBLE or CLEARLY * free[0].share >= stated:
        return None
    before = set(case.ways[0].words) if case.ways else set()
    other = "; ".join(w for w in free[0].words if w not in before) or "another unit"
    missed = f"and misses them by {percent(stated)} of their spread as stated"
    return Explanation(
        free[0].share,
        "wrong-unit",
        f"the units in the headers contradict the readings: the nominal machine fits with "
        f"{other}, {missed if case.ways else 'and not at all as stated'}",
        "correct the unit in the header, or state --infer-units, which takes none from headers",
        ("--infer-units",),
    )


def unplaced(case: Case) -> Explanation | None:
    """What lets the machine be placed that no way to read the columns places."""
    explanations = chain(turned_round(case, 1), exchanged(case))
    fitting = (e for e in explanations if e.share <= PLAUSIBLE)
    return min(fitting, key=lambda e: e.share, default=None)


def objection(case: Case) -> Explanation | None:
    """What explains the readings far better than any way to read them; else that nothing does.

    None where the machine explains them well enough to be calibrated.
    """
    best = case.ways[0]
    explanations: list[Explanation] = []
    tried = (  # the quickest first; each begins when it is its turn
        _shifted_too(case),
        _rows_in_other_units(case),
        _joint_rows_in_other_units(case),
        _moved_too(case),
        _coordinates(case),
        _orientations(case),
        turned_round(case, 1),
        displaced_zeros(case, 1),
        exchanged(case),
        turned_round(case, 2),
        displaced_zeros(case, -1),
        coupled(case),
        several(case),
        _shuffled(case),
    )
    for explained in chain.from_iterable(tried):
        explanations.append(explained)
        if explained.share <= SURE:
            break
    clear = [e for e in explanations if e.share <= PLAUSIBLE and CLEARLY * e.share < best.share]
    if clear:
        return min(clear, key=lambda e: e.share)
    return None if best.share <= NOTHING else _nothing(case)


def shifted(case: Case, ways: Sequence[Understood]) -> Explanation | None:
    """Where the readings of the instrument fit far better some rows apart."""
    explanations = [
        e
        for way in ways
        for meaning in way.seen
        if as_large(meaning, way.bodies)
        for e in _displaced(case, way, meaning)
    ]
    return min(explanations, key=lambda e: e.share, default=None)


def _shifted_too(case: Case) -> Iterator[Explanation]:
    """Of every way to read the columns, where none of them fits."""
    shift = None if case.share <= NOTHING else shifted(case, case.ways)
    if shift is not None:
        yield shift


def _displaced(case: Case, way: Understood, meaning: Meaning) -> Iterator[Explanation]:
    every = np.arange(len(way.bodies.origins))
    whole = meaning.fitted(way.bodies).share
    for shift in _SHIFTS:
        rows, moved = (
            (every[:-shift], every[shift:]) if shift > 0 else (every[-shift:], every[:shift])
        )
        if len(rows) < 10:
            continue
        turns = None if meaning.turns is None else meaning.turns[moved]
        apart = replace(meaning, position=meaning.position[moved], turns=turns)
        bodies, few = way.bodies.take(rows), _few(len(rows))
        if apart.fitted(bodies, few, 1).share > 2.0 * NOTHING:  # unrelated points leave 0.8 or more
            continue
        share = apart.fitted(bodies).share
        if CLEARLY * share < whole and share < NOTHING:
            where, plural = "late" if shift > 0 else "early", "s" if abs(shift) > 1 else ""
            joined, remedy = _joined_by(case.fields)
            words = (
                f"the readings of the instrument stand {abs(shift)} row{plural} too {where} "
                f"beside those of the joints, {joined} (misfit {percent(whole)} of the spread as "
                f"they stand, {percent(share)} if moved)"
            )
            yield Explanation(share, "mismatched-poses", words, remedy)


def _joined_by(fields: Fields) -> tuple[str, str]:
    """What brought joints and instrument together, and what to do where that is wrong."""
    if fields.by_order:
        remedy = "give both files a column of pose ids, or remove the row too many"
        return "which were joined by row order", remedy
    if len(fields.sources) > 1:
        remedy = "correct the pose ids: they do not name the same poses in both files"
        return "which were joined by pose id", remedy
    return "in the same file", "move these columns, or remove the row too many"


def _coordinates(case: Case) -> Iterator[Explanation]:
    """A mirrored frame, and one coordinate in another unit than the others."""
    for way in case.ways:
        signs = _mirrored(case, way)
        if signs is not None:
            yield signs
        for meaning in way.seen:
            fields = meaning.seen.position
            if meaning.position.ndim < 2 or len(fields) != 3 or meaning.seen.kind == "spherical":
                continue
            # One mirror is enough: two differ by a rotation, which the placement takes.
            share = _scaled(way, meaning, _MIRROR)
            if signs is None:
                yield Explanation(
                    share,
                    "implausible-readings",
                    f"{names_of(fields)} form a left-handed frame: mirrored, the nominal machine "
                    f"misses the readings by {percent(share)} of their spread, as read by "
                    f"{percent(way.share)}",
                    "two of the columns are exchanged, or one has the wrong sign: correct it",
                )
            for axis, field in enumerate(fields):
                for other in LENGTHS:
                    factors = np.ones(3)
                    factors[axis] = unit(other).factor / unit(meaning.length).factor
                    share = _scaled(way, meaning, factors)
                    yield Explanation(
                        share,
                        "wrong-unit",
                        f"{field.label} is in {other}, and the other coordinates are in "
                        f"{meaning.length}: so the nominal machine misses the readings by "
                        f"{percent(share)} of their spread",
                        "convert the column, or state the unit of each in its header",
                    )


def _orientations(case: Case) -> Iterator[Explanation]:
    """Orientations whose numbers are under each other's headers, or that are inverse though the
    points are not."""
    for way in case.ways:
        for meaning in (m for m in way.seen if m.seen.turned and m.seen.form != "matrix"):
            seen = meaning.seen
            point = positions(seen, meaning.length, meaning.angle, meaning.form)
            R = turned_by(seen, meaning.angle, meaning.form, meaning.order)
            tried = {f"{names_of(seen.turned)} hold the inverse rotation": np.swapaxes(R, 1, 2)}
            for order in permutations(meaning.order):
                moved = [
                    seen.turned[i] for i, j in zip(meaning.order, order, strict=True) if i != j
                ]
                if moved:
                    words = f"{names_of(moved)} are under each other's headers"
                    tried[words] = turned_by(seen, meaning.angle, meaning.form, order)
            few = _few(len(point))
            for words, turns in tried.items():
                other = replace(meaning, inverted=False, position=point, turns=turns)
                share = other.fitted(way.bodies, few, 2).share
                yield Explanation(
                    share,
                    "implausible-readings",
                    f"{words}: corrected, the nominal machine misses the readings by "
                    f"{percent(share)} of their spread, as read by {percent(way.share)}",
                    "correct the headers, or convert the columns",
                )


def _rows_in_other_units(case: Case) -> Iterator[Explanation]:
    """Rows nearer than the others, or farther, by so much that they may be in another unit."""
    for way in case.ways:
        for meaning in way.seen:
            if meaning.position.ndim < 2 or meaning.seen.kind == "spherical":
                continue
            names = names_of(meaning.seen.position)
            away = np.linalg.norm(meaning.position, axis=1)
            for (near, far), other in product(set_apart(away), LENGTHS):
                factor = unit(other).factor / unit(meaning.length).factor
                rows = near if factor > 1.0 else far
                share = _scaled(way, meaning, np.where(rows, factor, 1.0)[:, None])
                yield Explanation(
                    share,
                    "wrong-unit",
                    f"{_which(rows)} of {names} {_written(other)}, and the others "
                    f"{_written(meaning.length)}: so the nominal machine misses the readings by "
                    f"{percent(share)} of their spread, as read by {percent(way.share)}",
                    "convert these rows",
                )


def _joint_rows_in_other_units(case: Case) -> Iterator[Explanation]:
    """Rows whose joints move by so much more than the others, or less, that they may be in another
    unit."""
    for way, (kind, others) in product(case.ways, (("rad", ANGLES), ("m", LENGTHS))):
        alike = [i for i, one in enumerate(way.kinds) if one == kind]
        if len(units := {way.units[i] for i in alike}) != 1:
            continue
        moving = dict([*way.joints.items()][i] for i in alike)
        names = names_of([way.layout.joints[i] for i in alike])
        read_as, few = units.pop(), _few(len(way.bodies.origins))
        size = np.linalg.norm([*moving.values()], axis=0)
        for (small, large), other in product(set_apart(size), others):
            factor = unit(other).factor / unit(read_as).factor
            if factor == 1.0:
                continue
            rows = small if factor > 1.0 else large
            moved = {n: q * np.where(rows, factor, 1.0) for n, q in moving.items()}
            bodies = case.machine.bodies(way.joints | moved)
            share = max(m.fitted(bodies, few, 2).share for m in way.seen)
            yield Explanation(
                share,
                "wrong-unit",
                f"{_which(rows)} of {names} {_written(other)}, and the others {_written(read_as)}: "
                f"so the nominal machine misses the readings by {percent(share)} of their spread, "
                f"as read by {percent(way.share)}",
                "convert these rows",
            )


def _written(name: str) -> str:
    return {"in": "are in inches", "deg": "are in degrees", "rad": "are in radians"}.get(
        name, f"are in {name}"
    )


def _which(rows: NDArray[np.bool_]) -> str:
    """Rows from 1, in words."""
    numbers = np.flatnonzero(rows) + 1
    first, last = int(numbers[0]), int(numbers[-1])
    if last - first + 1 == len(numbers):
        return f"rows {first} to {last}" if last > first else f"row {first}"
    return f"{len(numbers)} of {len(rows)} rows (the first is {first})"


def _mirrored(case: Case, way: Understood) -> Explanation | None:
    """The fewest joints that, counted the other way round, leave what mirrored frames leave.

    A machine whose drawing has a plane of symmetry mirrors its motion so. No reading tells the two
    apart, and makers' signs of joints are the more frequent.
    """
    points = [
        replace(m, turns=None, seen=_as_point(m))
        for m in way.seen
        if m.in_space and not m.inverted and as_large(m, way.bodies)
    ]
    shares = [_scaled(way, m, _MIRROR) for m in points]
    share = max(shares, default=1.0)
    if not (share <= PLAUSIBLE and CLEARLY * share < way.share):
        return None
    joints, few = case.machine.joints, _few(len(points[0].position))
    for names in (n for k in range(len(joints)) for n in combinations(joints, k + 1)):
        bodies = case.machine.bodies({n: -q if n in names else q for n, q in way.joints.items()})
        fits = (m.fitted(bodies, few, 2).share for m in points)
        if all(fit < CLEARLY * mirror for fit, mirror in zip(fits, shares, strict=True)):
            pairs = zip(joints, way.layout.joints, strict=True)
            columns = [signed(f.label, -1 if n in names else 1) for n, f in pairs]
            count = "counts" if len(names) == 1 else "count"
            frames = " and ".join(names_of(m.seen.position) for m in points)
            return Explanation(
                share,
                "implausible-readings",
                f"{', '.join(names)} {count} the other way round, or {frames} have a left-handed "
                f"frame: so the nominal machine misses the readings by {percent(share)} of their "
                f"spread, as read by {percent(way.share)}",
                "state --joints, or correct the frame: two columns are exchanged, or one has the "
                "wrong sign",
                ("--joints", ",".join(columns)),
            )
    return None


def _scaled(way: Understood, meaning: Meaning, factors: Array) -> float:
    """The misfit with coordinates multiplied by these; of a pose its position alone counts."""
    # Columns of an inverted pose are not its position, so no factor of one of them can be tried.
    if meaning.inverted or (factors == 1.0).all():
        return float("inf")
    position = meaning.position * factors
    scaled = replace(meaning, position=position, turns=None, seen=_as_point(meaning))
    if not as_large(scaled, way.bodies):
        return float("inf")
    return scaled.fitted(way.bodies, _few(len(position)), 2).share


def _few(count: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, count - 1, min(count, _FEW)).astype(np.intp))


def _as_point(meaning: Meaning) -> Seen:
    return replace(meaning.seen, kind="point", turned=()) if meaning.seen.turned else meaning.seen


def _shuffled(case: Case) -> Iterator[Explanation]:
    """Of every way to read the columns, the first whose points fit in another order."""
    for way in case.ways if case.share > NOTHING else ():
        for meaning in (m for m in way.seen if as_large(m, way.bodies)):
            share = reordered(way.bodies, meaning).share
            if share <= PLAUSIBLE:
                yield Explanation(
                    share,
                    "mismatched-poses",
                    "the points do not belong to the joints row by row: in another order the "
                    f"nominal machine misses them by {percent(share)} of their spread, as they "
                    f"stand by {percent(case.share)}",
                    "give the joints and the points of a pose the same id, each in a file with a "
                    'column "pose", and run: loopcal init JOINTS.csv POINTS.csv',
                )
                return


def _nothing(case: Case) -> Explanation:
    """That the machine explains nothing, with the likely cause where the readings show one."""
    best = case.ways[0]
    far = float(np.sqrt(np.square(_about_median(best.bodies.origins)).sum(axis=1)).max())
    if far < ONE_POSE:
        return Explanation(
            best.share,
            "too-few-poses",
            f"these {len(best.bodies.origins)} rows are readings of one pose: the joints move the "
            f"robot by {with_unit(far, 'm', 2)}",
            "measure poses that differ in every joint; loopcal noise gives the sds of sensors from "
            "repeated readings",
            follows="loopcal init ROBOT --out planned",
        )
    read = [field for one in best.layout.seen for field in (*one.position, *one.turned)]
    if still := [f for f in read if np.nanmin(f.values) == np.nanmax(f.values)]:
        verb = "reads" if len(still) == 1 else "read"
        return Explanation(
            best.share,
            "implausible-readings",
            f"{names_of(still)} {verb} the same value in every row, although the machine moves",
            "correct the file, or name the column that has the readings",
        )
    if odd := _odd_units(best.share, case.fields.fields):
        return odd
    remedy = (
        "check the robot (URDF, Denavit-Hartenberg table and its convention), the signs and zeros "
        "of the joints, and that joints and instrument are of the same poses"
    )
    if case.machine.frame is not None:
        remedy += (
            "; state every joint, length and offset of the machine: those left out have the values "
            "of the example that `loopcal new` writes"
        )
    if case.fields.by_order:
        remedy += "; their rows were joined by order: give both files a column of pose ids"
    joints = best.layout.joints
    if reads_counts(joints):
        remedy = f"convert {names_of(joints)} to angles: they read like counts of encoders"
    return Explanation(
        best.share,
        "implausible-readings",
        "the nominal machine does not describe these readings: in the best of all units and orders "
        f"it misses them by {percent(best.share)} of their spread, with {names_of(joints)} as its "
        f"joints and {names_of(read)} as readings",
        remedy,
    )


def _odd_units(share: float, fields: Sequence[Field]) -> Explanation | None:
    """Where a header has in brackets what is no unit, and others like it have one."""
    for f in fields:
        match = None if f.unit else _BRACKETS.fullmatch(f.label)
        alike = [o for o in fields if match and o.label.startswith(match["name"][:1])]
        stated = [o.label for o in alike if o.unit]
        if match and stated:
            return Explanation(
                share,
                "unknown-unit",
                f"{match['unit']!r} in the header {f.label!r} is no known unit",
                f"write the unit as in {stated[0]!r}, or let it be inferred by --joints",
                ("--joints", ",".join(o.label for o in alike)),
            )
    return None


def _moved_too(case: Case) -> Iterator[Explanation]:
    """Of every way to read the columns, the first that fits in blocks."""
    return islice((e for way in case.ways if (e := _moved(way))), 1)


def _moved(way: Understood) -> Explanation | None:
    """Where blocks of poses fit alone, but not together: the instrument was moved between them."""
    count = len(way.bodies.origins)
    blocks = [np.arange(i, i + _BLOCK) for i in range(0, count - _BLOCK + 1, _BLOCK)]
    meaning = way.seen[0]
    if len(blocks) < 3 or not as_large(meaning, way.bodies):
        return None
    alone = [meaning.fitted(way.bodies, b) for b in blocks]
    if np.median([m.share for m in alone]) > _TOGETHER:
        return None
    last = next(
        end
        for end in range(2, len(blocks) + 1)
        if end == len(blocks) or not _together(way, meaning, np.concatenate(blocks[: end + 1]))
    )
    row = min(last * _BLOCK, count - 1) + 1
    return Explanation(
        alone[0].share,
        "implausible-readings",
        f"the instrument or the robot's base was moved during the run, first near row {row}: "
        f"blocks of {_BLOCK} poses fit the nominal machine, all of them together do not",
        f"rename the column {places.label!r} to 'station': the rows of each of its values fit"
        if (places := _places(way, meaning))
        else "add a column 'station' that names the place of the instrument in each row, such as 1 "
        "and 2; write the rows of each robot to a file of their own where they are of several",
    )


def _places(way: Understood, meaning: Meaning) -> Field | None:
    """The unused column by whose values the rows fit."""
    for field in way.layout.ignored:
        groups = [np.flatnonzero(field.values == v) for v in np.unique(field.values)]
        if (
            1 < len(groups) <= MOST_TARGETS
            and min(map(len, groups)) >= FEWEST
            and all(_together(way, meaning, rows) for rows in groups)
        ):
            return field
    return None


def _together(way: Understood, meaning: Meaning, rows: NDArray[np.intp]) -> bool:
    return meaning.fitted(way.bodies, rows).share <= _TOGETHER


def _about_median(points: Array) -> Array:
    finite = points[np.isfinite(points).all(axis=1)]
    return finite - np.median(finite, axis=0)
