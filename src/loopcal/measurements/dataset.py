"""The readings of every pose: what was read, in SI, with ids and with the file they came from."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError, Instead, nearest, unknown_name
from loopcal.measurements.poses import counted, pose_id, positions_of
from loopcal.measurements.source import Source
from loopcal.measurements.tables import as_numbers, column, column_names
from loopcal.units import difference_to_si, to_si, unit

_MOST = {"rad": 1e8, "": 1e30}
"""SI unit -> what no reading exceeds: of an angle the eighth digit would be gone, else of anything.
"""


@dataclass(frozen=True, eq=False, repr=False)
class Dataset:
    """Readings of N poses, SI; arrays are float64, contiguous and read-only.

    Raises InputError when lengths differ, a reading is infinite or implausibly large, an sd is
    negative or missing, or no pose is left. Make one with `from_arrays`, of which Dataset(table) is
    the same, or `read_dataset`.
    """

    readings: Mapping[str, Array]
    """Quantity -> (N,) [SI]; NaN: not measured in that pose."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Quantity -> SI unit, for those whose unit was stated; the others are taken as SI."""
    poses: tuple[str, ...] = ()
    """Id of each pose, as text; "1" to "N" where none were given."""
    sds: Mapping[str, Array] = field(default_factory=dict)
    """Quantity -> (N,) sd [SI] of each reading, for those that came with their own."""
    source: Source = field(default_factory=Source)
    places: Mapping[str, float] = field(default_factory=dict)
    """Parameter -> roughly its value [SI], as images alone say where boards and cameras stand."""
    counts: Mapping[str, Array] = field(default_factory=dict)
    """Quantity -> (N,) of how many readings each one is the mean, for those that are means."""

    def __post_init__(self) -> None:
        empty = isinstance(self.readings, Mapping) and not any(map(np.size, self.readings.values()))
        if not self.poses and not empty:  # of a table or arrays, as `from_arrays` takes them
            made = Dataset.from_arrays(self.readings, units=self.units or None)
            for name in ("readings", "units", "poses", "source"):
                object.__setattr__(self, name, getattr(made, name))
        object.__setattr__(self, "readings", {q: _kept(v) for q, v in self.readings.items()})
        object.__setattr__(self, "sds", {q: _kept(v) for q, v in self.sds.items()})
        if self.source.rows is not None:
            self.source.rows.flags.writeable = False
        _check_shapes(self)
        _check_values(self)

    from_pandas = from_dataframe = from_csv = Instead(
        "lc.calibrate or lc.init, which take tables and files as they are; or Dataset.from_arrays"
    )

    @classmethod
    def from_arrays(
        cls,
        table: Any,
        *,
        units: Mapping[str, str] | None = None,
        poses: str | Sequence[object] | None = None,
        sds: Mapping[str, str | ArrayLike] | None = None,
    ) -> Dataset:
        """A dataset from a dict of (N,) arrays or any DataFrame (pandas, polars, pyarrow).

        `units` says quantity -> unit of the values given; they become SI. Nothing is guessed:
        a quantity without a unit is taken as SI already (m, rad). `sds` holds (N,) sds in the
        unit of their quantity. `poses` are ids. A text in place of `poses` or of an sd names a
        column of the table, which then is no quantity. NaN, None, NA: not measured.
        Raises InputError for anything that is no column of finite numbers.

        >>> Dataset.from_arrays({"x": [1.0, 2.0]}, units={"x": "mm"}).readings["x"]
        array([0.001, 0.002])
        """
        units, sds = dict(units or {}), dict(sds or {})
        sd_columns = {q: name for q, name in sds.items() if isinstance(name, str)}
        aside = {*sd_columns.values(), *([poses] if isinstance(poses, str) else [])}
        names = [name for name in column_names(table) if name not in aside]
        for name in (*units, *sds):
            if name not in names:
                raise unknown_name(
                    f"a unit or sd is given for {name!r}, which is not in the table", name, names
                )

        def si(
            name: str, values: Any, what: str, convert: Callable[[Array, str], Array] = to_si
        ) -> Array:
            numbers = as_numbers(values, what)  # an array of its own
            numbers = convert(numbers, units[name]) if name in units else numbers
            numbers.flags.writeable = False  # is kept then, without another copy
            return numbers

        readings = {q: si(q, table[q], f"column {q!r}") for q in names}
        spread = {
            q: si(
                q,
                column(table, s) if isinstance(s, str) else s,
                f"the sd of {q!r}",
                difference_to_si,
            )
            for q, s in sds.items()
        }
        number = len(next(iter(readings.values()), ()))
        listed = column(table, poses) if isinstance(poses, str) else poses
        ids = counted(number) if listed is None else tuple(map(pose_id, listed))
        entry: dict[str, Any] = {"pose": poses} if isinstance(poses, str) else {}
        if entry or units or sd_columns:
            both = (("unit", units), ("sd_column", sd_columns))
            columns = {
                q: {"column": q, **{key: of[q] for key, of in both if q in of}} for q in names
            }
            entry = {"file": "", "columns": columns, **entry}
        return cls(
            readings,
            {q: unit(u).si for q, u in units.items()},
            ids,
            spread,
            Source(rows_read=number, stated=units, sd_columns=sd_columns, entry=entry),
        )

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of what was read, in the order of the table."""
        return tuple(self.readings)

    def __len__(self) -> int:
        return len(self.poses)

    def __getitem__(self, quantity: str) -> Array:
        """Readings (N,) [SI] of one quantity; InputError naming the nearest if there is none."""
        if quantity not in self.readings:
            raise unknown_name(f"there are no readings of {quantity!r}", quantity, self.readings)
        return self.readings[quantity]

    def place(self, index: int, quantity: str | None = None, *, sd: bool = False) -> str:
        """How messages call the value at position `index`: file, row and column where known."""
        return self.source.place(index, self.poses[index], quantity, sd=sd)

    def take(self, which: ArrayLike | slice) -> Dataset:
        """The poses at these positions (from 0), in this order; a boolean mask (N,) or a slice.

        A position may come several times: its pose then counts as often.
        """
        index = np.arange(len(self), dtype=np.int64)[
            which if isinstance(which, slice) else np.asarray(which)
        ]
        return replace(
            self,
            readings={q: v[index] for q, v in self.readings.items()},
            poses=tuple(self.poses[i] for i in index),
            sds={q: v[index] for q, v in self.sds.items()},
            counts={q: v[index] for q, v in self.counts.items()},
            source=self.source.take(index),
        )

    def select(self, poses: Iterable[object]) -> Dataset:
        """The poses with these ids, in the order of the data.

        Raises InputError naming the nearest id when one is unknown.
        """
        return self.take(positions_of(poses, self.poses, self.source.name))

    def exclude(self, poses: Iterable[object]) -> Dataset:
        """All poses but those with these ids; the source lists them.

        Raises InputError naming the nearest id when one is unknown, or when no pose is left.
        """
        # The positions of all rows of an id: repeated ids go together.
        gone = positions_of(poses, self.poses, self.source.name)
        names = tuple(dict.fromkeys(self.poses[i] for i in gone))
        source = replace(self.source, excluded=(*self.source.excluded, *names))
        kept = np.delete(np.arange(len(self)), gone)
        return replace(self, source=source).take(kept)

    def without_copies(self, copied: NDArray[np.intp]) -> Dataset:
        """All poses but those at these positions, whose rows copy others; the source lists them."""
        names = tuple(self.poses[i] for i in copied)
        source = replace(self.source, copied=(*self.source.copied, *names), judged=True)
        return self._without(copied, source)

    def with_agreeing(self, rows: NDArray[np.intp]) -> Dataset:
        """The same poses; the source lists those at these positions, which agree by chance."""
        names = tuple(self.poses[i] for i in rows)
        return replace(self, source=replace(self.source, agreeing=names, judged=True))

    def without_outliers(self, outlying: NDArray[np.intp]) -> Dataset:
        """All poses but those at these positions, which do not fit; the source lists them."""
        names = tuple(self.poses[i] for i in outlying)
        source = replace(self.source, discarded=(*self.source.discarded, *names))
        return self._without(outlying, source)

    def _without(self, index: NDArray[np.intp], source: Source) -> Dataset:
        source = replace(source, rows_read=source.rows_read or len(self))
        return replace(self, source=source).take(np.delete(np.arange(len(self)), index))

    def thin(self, every: int) -> Dataset:
        """The 1st, (every + 1)th, ... pose; InputError unless `every` is 1 or more."""
        step = checked_every(every)
        source = replace(self.source, every=self.source.every * step)
        return replace(self, source=source).take(slice(None, None, step))

    def with_readings(
        self, readings: Mapping[str, ArrayLike], *, units: Mapping[str, str] | None = None
    ) -> Dataset:
        """The same poses with readings (N,) replaced or added, SI unless `units` says otherwise."""
        stated_units = dict(units or {})
        new = {
            q: to_si(as_numbers(v, f"{q!r}"), stated_units.get(q, "1")) for q, v in readings.items()
        }
        columns = {q: c for q, c in self.source.columns.items() if q not in new}
        stated = {q: u for q, u in self.source.stated.items() if q not in new}
        entry = dict(self.source.entry)
        if entry or stated_units:  # what replaces a column of a file is in that file no more
            new_columns = {q: {"column": q, "unit": u} for q, u in stated_units.items()}
            left = {q: c for q, c in entry.get("columns", {}).items() if q not in new}
            entry = {"file": "", **entry, "columns": {**left, **new_columns}}
        return replace(
            self,
            readings={**self.readings, **new},
            units={**self.units, **{q: unit(u).si for q, u in stated_units.items()}},
            source=replace(
                self.source, columns=columns, stated={**stated, **stated_units}, entry=entry
            ),
        )

    def __repr__(self) -> str:
        origin = f" from {self.source.name}" if self.source.name else ""
        return f"<Dataset: {len(self)} poses of {', '.join(self.quantities)}{origin}>"

    def __str__(self) -> str:
        rows = [_HEAD, *self._summary()]
        widths = [max(len(row[i]) for row in rows) for i in range(len(_HEAD))]
        lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) for row in rows]
        return "\n".join([repr(self)[1:-1], *(line.rstrip() for line in lines)])

    def _repr_html_(self) -> str:
        from html import escape

        cells = "".join(
            "<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>"
            for row in self._summary()
        )
        head = "".join(f"<th>{name}</th>" for name in _HEAD)
        title = escape(repr(self)[1:-1])
        return f"<table><caption>{title}</caption><tr>{head}</tr>{cells}</table>"

    def _summary(self) -> list[tuple[str, ...]]:
        rows: list[tuple[str, ...]] = []
        for quantity, values in self.readings.items():
            read = values[~np.isnan(values)]
            ends = (f"{read.min():.6g}", f"{read.max():.6g}") if read.size else ("", "")
            rows.append((quantity, self.units.get(quantity, "SI"), str(read.size), *ends))
        return rows


_HEAD = ("quantity", "unit", "readings", "smallest", "largest")


def checked_every(every: int) -> int:
    """The step of thinning as an int; InputError unless it is a whole number from 1 on."""
    if isinstance(every, bool) or every != int(every) or every < 1:
        raise InputError(
            f"every is {every!r}",
            code="invalid-value",
            remedy="give a whole number, 1 or more",
        )
    return int(every)


def _kept(values: Array) -> Array:
    """The same values, read-only."""
    if values.flags.writeable or values.dtype != np.float64 or not values.flags.c_contiguous:
        values = np.array(values, dtype=np.float64, order="C")
        values.flags.writeable = False
    return values


def _check_shapes(data: Dataset) -> None:
    number = len(data)
    columns = [(f"{q!r}", v) for q, v in data.readings.items()]
    columns += [(f"the sd of {q!r}", v) for q, v in data.sds.items()]
    columns += [(f"the count of {q!r}", v) for q, v in data.counts.items()]
    for what, values in columns:
        if values.shape != (number,):
            raise InputError(
                f"{what} has {values.size} values for {number} poses",
                code="wrong-shape",
                place=data.source.name,
                remedy="give one value per pose, NaN where nothing was measured",
            )
    if not number:
        raise InputError(
            "no pose is left",
            code="no-data",
            place=data.source.name,
            remedy="give at least one pose",
        )
    for quantity in data.sds:
        if quantity not in data.readings:
            raise InputError(
                f"an sd is given for {quantity!r}, which has no readings",
                code="conflicting-keys",
                place=data.source.name,
                remedy=nearest(quantity, data.readings),
            )


def _check_values(data: Dataset) -> None:
    for quantity, values in data.readings.items():
        si = data.units.get(quantity, "")
        for i in np.flatnonzero(np.abs(values) > _MOST.get(si, _MOST[""]))[:1]:
            finite = np.isfinite(values[i])
            why = "beyond any sensor" if finite else "not a finite number"
            raise InputError(
                f"the reading of {quantity!r} is {values[i]:.6g} {si}".rstrip() + f", {why}",
                code="implausible-readings" if finite else "invalid-number",
                place=data.place(int(i), quantity),
                remedy="leave it blank (NaN) if nothing was measured; if many readings are like "
                "this, the file is damaged",
            )
    for quantity, sd in data.sds.items():
        missing = np.isnan(sd) & ~np.isnan(data.readings[quantity])
        for i in np.flatnonzero(missing | (sd < 0))[:1]:
            wrong = "missing beside its reading" if missing[i] else f"{sd[i]:.6g}, below zero"
            raise InputError(
                f"the sd of {quantity!r} is {wrong}",
                code="invalid-value",
                place=data.place(int(i), quantity, sd=True),
                remedy="give a number > 0, 0 for an exact reading, or inf for one not measured",
            )
