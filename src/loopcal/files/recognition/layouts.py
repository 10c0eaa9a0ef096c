"""Which columns are the joints and which an instrument's: by names first, else by their order."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from string import digits

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.recognition.fields import STATIONS, Field, moving, unnamed
from loopcal.files.recognition.headers import expanded, sd_of, words
from loopcal.files.recognition.joint_sets import (
    BY_MACHINE,
    NUMBERED,
    UNIT_NORM,
    families_of,
    joint_sets,
    quaternions,
    unit_norm,
    usual_joints,
)

_LENGTH_WORDS = frozenset(words("columns", "length"))
_POLAR = [words("columns", name) for name in ("range", "azimuth", "elevation")]
_TURN_WORDS = frozenset(words("columns", "turn"))
_TURNS = (
    *(("a", "b", "c"), ("w", "p", "r"), ("roll", "pitch", "yaw"), ("o", "a", "t")),
    *(("u", "v", "w"), ("a", "e", "r")),
)
_UNMEASURED = frozenset(words("columns", "unmeasured"))
_COORDINATES = frozenset(words("columns", "coordinate"))
_NO_PLACES = _UNMEASURED.union(words("columns", "temperature"), words("columns", "payload"))
_CELL = re.compile(r"^(?P<word>[a-z_]*?)_?(?P<row>[0-4])_?(?P<column>[0-4])$")
_STATED = "as stated"
FEWEST = 5
"""Rows that place an instrument."""
# Chosen, not derived: coordinates are written to 1e-6 of a range, and no two instruments agree so.
_ROUNDED = 1e-4
"""Share of a range by which one computed from coordinates differs."""
_ANGLES = 6
"""Columns beside a length at most of which two may be its angles."""


@dataclass(frozen=True, eq=False)
class Seen:
    """The columns of one instrument.

    kind: "point", "planar" (x and y of a point), "pose", "length" or "spherical"; position: its
    coordinates, its length, or range, azimuth and elevation; turned: the numbers of an
    orientation, whose form is "quaternion", "turns" or "matrix" (nine, row by row); sds: those of
    the position, if there; station: where it stood, as the column of stations says.
    """

    kind: str
    position: tuple[Field, ...]
    turned: tuple[Field, ...] = ()
    form: str = ""
    sds: tuple[Field, ...] = ()
    station: str = ""

    @property
    def rows(self) -> NDArray[np.intp]:
        """Positions of the poses that it has read."""
        return np.flatnonzero(np.isfinite(self.position[0].values))


@dataclass(frozen=True, eq=False)
class Layout:
    """One way to understand the columns. how: by what the joints were recognised."""

    joints: tuple[Field, ...]
    seen: tuple[Seen, ...]
    ignored: tuple[Field, ...]
    how: str


def layouts(
    fields: Sequence[Field],
    count: int,
    names: Sequence[str] = (),
    joints: tuple[Field, ...] = (),
) -> tuple[Layout, ...]:
    """Every way to find `count` joints and an instrument in the columns, by names where possible.

    names: of the machine's joints; joints: their columns, where they are stated. Of an instrument
    that stood in several places, as a column of stations says, the columns are taken once for each
    place. Raises InputError listing the columns where there is none.
    """
    stations = [f for f in fields if f.stem in STATIONS]
    if not stations:
        return _single_station(fields, count, names, joints)
    every = _single_station([f for f in fields if f.stem not in STATIONS], count, names, joints)
    return tuple(_by_station(one, stations[0]) for one in every)


def _by_station(layout: Layout, station: Field) -> Layout:
    """With the columns of its instruments once for each station, blank in rows of the others.

    Raises InputError for rows without a station, and for a station with too few rows.
    """
    places = np.unique(station.values[np.isfinite(station.values)])
    if len(places) < 2:
        return replace(layout, ignored=(*layout.ignored, station))
    if not np.isfinite(station.values).all():
        row = int(np.flatnonzero(~np.isfinite(station.values))[0])
        raise InputError(
            f"row {row + 1} of the readings has no station in the column {station.label!r}",
            code="missing-reading",
            remedy="state where the instrument stood, or remove the row",
        )
    counts = {place: int((station.values == place).sum()) for place in places}
    least = min(places, key=lambda place: counts[place])
    if counts[least] < FEWEST:
        raise InputError(
            f"station {station.words(least)} in the column {station.label!r} has "
            f"{counts[least]} rows, and {FEWEST} are needed to place an instrument",
            code="too-few-poses",
            remedy="measure more poses from there, remove its rows, or rename the column",
        )
    seen = [
        at_station(s, station.values == place, station.words(place))
        for place in places
        for s in layout.seen
    ]
    return replace(layout, seen=tuple(seen))


def at_station(seen: Seen, rows: NDArray[np.bool_], station: str) -> Seen:
    """The instrument at one station, whose rows are these."""

    def only(fields: tuple[Field, ...]) -> tuple[Field, ...]:
        return tuple(replace(f, values=np.where(rows, f.values, np.nan)) for f in fields)

    position, turned, sds = only(seen.position), only(seen.turned), only(seen.sds)
    return replace(seen, position=position, turned=turned, sds=sds, station=station)


def _single_station(
    fields: Sequence[Field], count: int, names: Sequence[str], joints: tuple[Field, ...]
) -> tuple[Layout, ...]:
    if joints and len(joints) != count:
        raise InputError(
            f"{len(joints)} columns are stated as joints, and the machine has {count}",
            code="missing-column",
            place="--joints",
            remedy="state a column for each joint, in the order of the machine",
        )
    sets = [(joints, _STATED)] if joints else joint_sets(fields, count, names)
    if sets:
        taken = {id(f) for some, _ in sets for f in some}
        taken |= _read_by(fields, joints)
        if not instruments([f for f in fields if id(f) not in taken]):
            taken = set()  # sets of joints that leave no instrument exclude each other
            named = [one for one in sets if instruments([f for f in fields if f not in one[0]])]
            sets = named or sets
        made, refusals = list[Layout](), list[InputError]()
        for some, how in sets:
            try:
                made += _with_joints(fields, some, how, taken)
            except InputError as error:
                refusals.append(error)
        if made:
            return tuple(made)
        by_name = joints or sets[0][1] == BY_MACHINE
        if by_name or len(usual_joints(fields)) in (0, count):
            raise refusals[0]
    if usual := usual_joints(fields):
        more = "E1 or another axis" if len(usual) > count else "a joint"
        raise InputError(
            f"the columns {unnamed(usual)} look like {len(usual)} joints, but the machine has "
            f"{count} moving joints",
            code="missing-column",
            remedy=f"name its other links (--base, --tip), or rename the column of {more}",
        )
    return _by_order(fields, count)


def with_points_for_turns(layout: Layout) -> Layout | None:
    """With three columns that were taken for turns as a point of their own, such as errors eX, eY,
    eZ; None where there are none."""
    seen = []
    for one in layout.seen:
        if one.form != "turns":
            seen.append(one)
            continue
        seen.append(replace(one, kind="point", turned=(), form=""))
        seen.append(Seen("point", one.turned, station=one.station))
    return None if len(seen) == len(layout.seen) else replace(layout, seen=tuple(seen))


def _read_by(fields: Sequence[Field], joints: Sequence[Field]) -> set[int]:
    """Columns whose place in their table is that of a joint that was computed from them."""
    places = {(f.table, f.position) for f in joints}
    return {id(f) for f in fields if (f.table, f.position) in places}


def _with_joints(
    fields: Sequence[Field], joints: tuple[Field, ...], how: str, taken: Collection[int]
) -> tuple[Layout, ...]:
    """taken: ids of columns that are no instrument's."""
    taken = {*taken, *map(id, joints)}
    rest = [f for f in fields if id(f) not in taken]
    seen = instruments(rest)
    if seen:
        return (_layout(joints, seen, fields, how), *_trackers(joints, seen, rest, fields, how))
    free = [f for f in rest if not f.is_time]
    for some in _in_line(free):
        in_order = tuple(_layout(joints, (one,), fields, how) for one in _read_in_order(some))
        if in_order:
            return in_order
    # A z that is stated as a joint, as of a SCARA, is none of a point.
    other = [f for f in fields if f not in joints] if how == _STATED else fields
    if seen := numbered(free) or _planar(free, other):
        return (_layout(joints, seen, fields, how),)
    if coordinates := [f for f in free if f.span > 0.0 and _is_coordinate(f)]:
        raise InputError(
            f"{unnamed(coordinates)} alone places no point",
            code="missing-column",
            remedy="measure x, y and z, or x and y. Heights above a plate are the gap of an "
            'instrument of type "plane", in a mechanism file: docs/reference/mechanism-file.md',
        )
    raise InputError(
        f"no column of an instrument is recognised among {unnamed(rest)}"
        if rest
        else "every column is a joint; no instrument is recognised",
        code="missing-column",
        remedy='name them "x", "y", "z" (a point), add "qw", "qx", "qy", "qz" (a pose), or name '
        'one "length" (a wire). Other instruments, such as an inclinometer, stand in a mechanism '
        "file: docs/reference/mechanism-file.md",
    )


def _in_line(fields: Sequence[Field]) -> Iterator[Sequence[Field]]:
    """The columns that may be an instrument's by their number: those without names first."""
    for some in ([f for f in fields if not f.stem], fields):
        yield some
        # Only the last may stand still: a coordinate that does would be mistaken for what follows.
        move = moving(some)
        if move == tuple(some[: len(move)]):
            yield move


def _trackers(
    joints: tuple[Field, ...],
    seen: Sequence[Seen],
    rest: Sequence[Field],
    fields: Sequence[Field],
    how: str,
) -> Iterator[Layout]:
    """A length beside two columns of no other use: it may be a range, and they its angles."""
    used = {id(f) for s in seen for f in (*s.position, *s.turned, *s.sds)}
    free = [f for f in rest if id(f) not in used and f.span > 0.0 and not f.is_time]
    for length in [s for s in seen if s.kind == "length"] if len(free) <= _ANGLES else ():
        others = tuple(s for s in seen if s is not length)
        for pair in permutations(free, 2):
            tracker = Seen("spherical", (*length.position, *pair))
            yield _layout(joints, (*others, tracker), fields, how)


def _layout(
    joints: tuple[Field, ...], seen: tuple[Seen, ...], fields: Sequence[Field], how: str
) -> Layout:
    used = {id(f) for f in joints}
    used |= {id(f) for s in seen for f in (*s.position, *s.turned, *s.sds)}
    used |= _read_by(fields, [f for f in joints if f.computed])
    return Layout(joints, seen, tuple(f for f in fields if id(f) not in used), how)


def _by_order(fields: Sequence[Field], count: int) -> tuple[Layout, ...]:
    """Joints where nothing is named: the first columns, or those that are no instrument's."""
    seen = instruments(fields)
    taken = {id(f) for s in seen for f in (*s.position, *s.turned, *s.sds)}
    rest = [f for f in fields if id(f) not in taken and not f.is_time]
    if seen:
        for some in (rest, moving(rest)):
            if len(some) == count:
                return (_layout(tuple(some), seen, fields, "by the order of the columns"),)
    candidates: list[Layout] = []
    usable = [f for f in fields if not f.is_time]
    # A column that only rises is a clock or a counter.
    ordered = [f for f in usable if not (np.diff(f.values) > 0.0).all()]
    for some in (usable, moving(usable), ordered):
        for joints, others in ((some[:count], some[count:]), (some[-count:], some[:-count])):
            if len(joints) == count:
                how = "by the order of the columns"
                candidates += [
                    _layout(tuple(joints), (instrument,), fields, how)
                    for instrument in _read_in_order(others)
                ]
        if candidates:
            return tuple(candidates)
    raise InputError(
        f"the columns {unnamed(fields)} do not show which {count} are the joints",
        code="missing-column",
        remedy=f'name them "J1" to "J{count}", and those of the instrument "x", "y", "z"',
    )


def _read_in_order(fields: Sequence[Field]) -> Iterator[Seen]:
    """What columns without names may be, by their number and their lengths."""
    f = tuple(fields)
    match len(f):
        case 1 if not _is_coordinate(f[0]):
            yield Seen("length", f)
        case 3:
            yield Seen("point", f)
        case 6:
            yield Seen("pose", f[:3], f[3:], "turns")
        case 7:
            for turned, position in ((f[3:], f[:3]), (f[:4], f[4:])):
                if unit_norm(turned):
                    yield Seen("pose", position, turned, "quaternion")
        case 12:
            yield from _of_rows([f[4 * i : 4 * i + 4] for i in range(3)])
            for matrix, position in ((f[:9], f[9:]), (f[3:], f[:3])):
                if _orthonormal(matrix):
                    yield Seen("pose", position, matrix, "matrix")
        case 16:
            rows = [f[4 * i : 4 * i + 4] for i in range(4)]
            for whole in (rows, [tuple(column) for column in zip(*rows, strict=True)]):
                if _is_last_row(whole[3]):
                    yield from _of_rows(whole[:3])


def _is_coordinate(field: Field) -> bool:
    """Whether its name is that of one coordinate of a point: z, z1, z_meas, height."""
    return bool(_COORDINATES & {word.rstrip(digits) for word in field.stem.split("_")})


def numbered(fields: Sequence[Field]) -> tuple[Seen, ...]:
    """The instruments whose columns differ in one number, as tracker[0] to tracker[2]."""
    return tuple(
        one
        for word, members in families_of(fields)
        if not _NO_PLACES & {*word.split("_")}
        for one in [*_read_in_order(members)][:1]
    )


def _planar(free: Sequence[Field], fields: Sequence[Field]) -> tuple[Seen, ...]:
    """What reads x and y alone, without a z: a grid encoder, a camera above a table."""
    by_stem = {f.stem: f for f in fields}
    whole = [id(f) for _, triple in _named_alike(fields, "xyz") for f in triple]
    pairs = [
        Seen("planar", pair, sds=_sds(pair, fields))
        for word, pair in _named_alike(free, "xy")
        if id(pair[0]) not in whole
        and not _of_something_else(word, pair, by_stem)
        and len(moving(pair)) == len(pair)
    ]
    return tuple(pairs)


def _of_rows(rows: Sequence[tuple[Field, ...]]) -> Iterator[Seen]:
    """Three rows of a matrix with the position in their fourth column."""
    matrix = tuple(cell for row in rows for cell in row[:3])
    if _orthonormal(matrix):
        yield Seen("pose", tuple(row[3] for row in rows), matrix, "matrix")


def _is_last_row(row: Sequence[Field]) -> bool:
    """0, 0, 0, 1 in every pose."""
    values = np.array([f.values for f in row])
    return bool(np.nanmax(np.abs(values - np.eye(4)[3][:, None]), initial=0.0) < 1e-9)


def instruments(fields: Sequence[Field]) -> tuple[Seen, ...]:
    """The instruments whose columns are named as they usually are."""
    by_stem = {f.stem: f for f in fields if f.stem}
    polar = [_first(by_stem, names) for names in _POLAR]
    read = tuple(f for f in polar if f is not None)
    if len(read) == len(polar):  # coordinates beside them are computed; a file of others is not
        others = [f for f in fields if f.table not in {one.table for one in read}]
        beside = [s for s in instruments(others) if s.kind == "point"]
        return (Seen("spherical", read), *(s for s in beside if not _as_far(s, read[0])))
    turned, form, position = _orientation(fields, by_stem)
    aside = {id(f) for f in turned}
    rest = [f for f in fields if id(f) not in aside]
    triples = list(_named_alike(rest, "xyz"))
    points = [t for word, t in triples if not _of_something_else(word, t, by_stem)]
    points = [t for t in points if len(moving(t)) > 1] or points
    seen: list[Seen] = []
    if form == "matrix" and not (position or points):  # such as t1, t2, t3 behind it
        behind = [f for f in rest if f.table == turned[0].table]
        behind = [f for f in behind if f.position > turned[-1].position]
        position = tuple(behind[:3]) if len(behind) > 2 else ()
    if turned and (position or points):
        if not position:  # that whose columns stand next to those of the turn
            nearest = min(points, key=lambda t: abs(turned[0].position - t[-1].position))
            points.remove(nearest)
        seen.append(Seen("pose", position or nearest, turned, form))
    seen += [Seen("point", point) for point in points]
    for field in rest:
        number = NUMBERED.match(field.stem)
        word = number["word"] if number else field.stem
        if word in _LENGTH_WORDS:
            seen.append(Seen("length", (field,)))
    return tuple(replace(s, sds=_sds(s.position, fields)) for s in seen)


def _as_far(point: Seen, distance: Field) -> bool:
    """Whether a point is as far as a tracker measured in all poses: computed from what it read."""
    read = np.where(distance.values == 0.0, np.nan, distance.values)  # a lost reflector
    far = np.sqrt(sum(np.square(f.values) for f in point.position)) / read
    far = far[np.isfinite(far)]
    return bool(far.size and np.ptp(far) < _ROUNDED * far.max())


def _orientation(
    fields: Sequence[Field], by_stem: dict[str, Field]
) -> tuple[tuple[Field, ...], str, tuple[Field, ...]]:
    """The numbers of an orientation, their form, and the position that a matrix brings along."""
    for turned, position in _matrices(fields, by_stem):
        return turned, "matrix", position
    for quaternion in quaternions(fields):
        return quaternion, "quaternion", ()
    triples = dict(_named_alike(fields, "xyz"))
    for word, turned in triples.items():
        # x, y and z of a file of their own are a point, also as rX, rY and rZ
        beside = any(t[0].table == turned[0].table for t in triples.values() if t is not turned)
        if word in _TURN_WORDS and beside:
            return turned, "turns", ()
    for names in _TURNS:
        if set(names) <= set(by_stem):
            return tuple(by_stem[n] for n in names), "turns", ()
    return (), "", ()


def _named_alike(fields: Sequence[Field], axes: str) -> Iterator[tuple[str, tuple[Field, ...]]]:
    """Columns whose names differ in one letter alone, x, y or z; with the rest of the name."""
    by_stem = {f.stem: f for f in fields if f.stem}
    met: set[str] = set()
    for field in fields:
        for i, letter in enumerate(field.stem):
            names = [f"{field.stem[:i]}{a}{field.stem[i + 1 :]}" for a in axes]
            if letter == "x" and names[0] not in met and all(n in by_stem for n in names):
                met.update(names)
                word = f"{field.stem[:i]}{field.stem[i + 1 :]}".strip("_")
                yield word, tuple(by_stem[n] for n in names)


def _of_something_else(word: str, triple: tuple[Field, ...], by_stem: dict[str, Field]) -> bool:
    """Whether these are sds of other columns, velocities, forces, or what a controller computed."""
    if word in _UNMEASURED or word.split("_")[0] in _UNMEASURED:
        return True
    return all(sd_of(f.stem, by_stem) or expanded(f.stem, by_stem) for f in triple)


def _sds(position: Sequence[Field], fields: Sequence[Field]) -> tuple[Field, ...]:
    by_stem = {f.stem: f for f in fields if f.stem}
    by_quantity = {of: f for f in fields if f.stem and (of := sd_of(f.stem, by_stem)) is not None}
    sds = tuple(by_quantity[p.stem] for p in position if p.stem in by_quantity)
    return sds if len(sds) == len(position) else ()


def _matrices(
    fields: Sequence[Field], by_stem: dict[str, Field]
) -> Iterator[tuple[tuple[Field, ...], tuple[Field, ...]]]:
    """Nine orthonormal columns, with a fourth column of the matrix as position if it is there."""
    for i in range(len(fields) - 11):  # three rows of four, whatever they are called
        twelve = tuple(fields[i : i + 12])
        if len({f.table for f in twelve}) == 1:
            for seen in _of_rows([twelve[4 * k : 4 * k + 4] for k in range(3)]):
                # the zeros below a matrix that stands column by column are no position
                if any(f.values.any() for f in seen.position):
                    yield seen.turned, seen.position
    cells: dict[str, dict[tuple[int, int], Field]] = {}
    for field in fields:
        match = _CELL.match(field.stem)
        if match:
            at = (int(match["row"]), int(match["column"]))
            cells.setdefault(match["word"], {})[at] = field
    for matrix in cells.values():
        begin = 0 if (0, 0) in matrix else 1
        grid = [[matrix.get((begin + i, begin + j)) for j in range(4)] for i in range(3)]
        turned = tuple(cell for row in grid for cell in row[:3] if cell is not None)
        position = tuple(row[3] for row in grid if row[3] is not None)
        if len(turned) == 9 and _orthonormal(turned):
            yield turned, position if len(position) == 3 else ()
    for i in range(len(fields) - 8):  # unit vectors, whatever they are called: Xi, Xj, Xk, Yi, ...
        nine = tuple(fields[i : i + 9])
        if len({f.table for f in nine}) == 1 and _orthonormal(nine):
            yield nine, ()
    names = [f"{c}{a}" for a in "xyz" for c in "noa"]  # the columns n, o, a and p of robotics
    if set(names) <= set(by_stem) and _orthonormal([by_stem[n] for n in names]):
        position = tuple(by_stem[f"p{a}"] for a in "xyz" if f"p{a}" in by_stem)
        yield tuple(by_stem[n] for n in names), position if len(position) == 3 else ()


def _orthonormal(fields: Sequence[Field]) -> bool:
    R = np.array([f.values for f in fields]).reshape(3, 3, -1).transpose(2, 0, 1)
    rotations = R[np.isfinite(R).all(axis=(1, 2))]
    # R R^T = 1 holds for mirrors too: whether it is one shows in the fit.
    off = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3))
    return bool(rotations.size and off.max() < UNIT_NORM)


def _first(by_stem: dict[str, Field], names: Iterable[str]) -> Field | None:
    return next((by_stem[n] for n in names if n in by_stem), None)
