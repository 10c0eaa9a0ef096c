"""A column of numbers with its heading, and a table as it was given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from loopcal.arrays import Array
from loopcal.errors import listed
from loopcal.files.recognition.headers import Heading, words
from loopcal.files.tables.recording import Recording
from loopcal.measurements.resolution import written_step
from loopcal.units import unit

STATIONS = frozenset(words("columns", "station"))
TOOLS = frozenset(words("columns", "tool"))
TIMES = frozenset(words("columns", "time"))
_STAMPS = frozenset({"time", "timestamp", "stamp"})
# Chosen, not derived: joints turn less than twice about, and cells are smaller.
_LARGE = {"rad": (4.0 * np.pi, "deg"), "m": (50.0, "mm")}
"""By SI unit, a number above which a column without a unit is in the other one."""
STILL = 1e-3
"""An axis whose readings span so much less than another's stands still."""


@dataclass(frozen=True, eq=False)
class Field:
    """A column of numbers, its rows those of the joined poses.

    table: number of its table; position: where it stands there, from 0; heading: None where the
    table has no header; labels: what its numbers 1, 2, ... stand for where it holds words;
    computed: whether it was computed from columns, as its header says.
    """

    table: int
    position: int
    heading: Heading | None
    values: Array
    labels: tuple[str, ...] = ()
    computed: bool = False

    @property
    def stem(self) -> str:
        """Its name in lower case; empty where it has none."""
        return self.heading.stem if self.heading else ""

    @property
    def unit(self) -> str | None:
        """The unit that its header states."""
        return self.heading.unit if self.heading else None

    def without_unit(self) -> Field:
        """The same column as if its header stated none."""
        return replace(self, heading=self.heading and replace(self.heading, unit=None))

    @property
    def label(self) -> str:
        """How the reader knows it: its header, or its number."""
        return self.heading.text if self.heading else f"column {self.position + 1}"

    def words(self, value: float) -> str:
        """A value as the file has it; empty for NaN."""
        if np.isnan(value):
            return ""
        return self.labels[round(value) - 1] if self.labels else f"{value:g}"

    @property
    def is_time(self) -> bool:
        """Whether it says when a row was read: its name, or the last word of it."""
        return self.stem in TIMES or self.stem.rpartition("_")[2] in _STAMPS

    @property
    def span(self) -> float:
        """Largest minus smallest value."""
        finite_values = self.values[np.isfinite(self.values)]
        return float(np.ptp(finite_values)) if finite_values.size else 0.0

    def resolution(self) -> float:
        """The step to which its values were rounded, a power of ten; 0 where there is none.

        It is 0 also for a column that stands still, whose one value may be round by chance.
        """
        step = written_step(self.values[np.isfinite(self.values)])
        return step or 0.0 if self.span else 0.0


@dataclass(frozen=True, eq=False)
class Source:
    """A table as it was given.

    path: of its file, None for a table in memory; sheet: of a workbook, or the variable of a MATLAB
    file that was asked for; ids: one per row, None where no column holds them; pose: that column's
    name or number; fields: its columns of numbers; names: its header; label: how messages call it
    without a path; remark: what was decided in reading it; recording: by time, of which it has the
    poses at rest; left_out: poses that take no part, as the user stated; texts: further columns of
    names by header, which differ in all rows.
    """

    path: Path | None
    sheet: str | None
    fields: tuple[Field, ...]
    ids: tuple[str, ...] | None
    pose: str | int | None
    names: tuple[str, ...] = ()
    label: str = ""
    remark: str = ""
    recording: Recording | None = None
    left_out: tuple[str, ...] = ()
    texts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """How messages call it."""
        number = self.fields[0].table + 1 if self.fields else 1
        return self.path.name if self.path else self.label or f"table {number}"

    def __len__(self) -> int:
        return len(self.fields[0].values)


def in_si(columns: Mapping[str, Field], units: Mapping[str, str]) -> dict[str, Array]:
    """Name -> numbers [SI] of its column; units: name -> SI unit. See `taken_in`."""
    taken = taken_in(columns, units)
    return {
        name: np.asarray(unit(f.unit or taken[units[name]]).factor * f.values)
        for name, f in columns.items()
    }


def taken_in(columns: Mapping[str, Field], units: Mapping[str, str]) -> dict[str, str]:
    """SI unit -> that of the columns without a stated one, by the size of all of them together."""
    taken = {}
    for si in dict.fromkeys(units[name] for name in columns):
        every = [f.values for name, f in columns.items() if units[name] == si and f.unit is None]
        numbers = np.abs(np.concatenate([*every, np.zeros(1)]))
        limit, other = _LARGE.get(si, (np.inf, si))
        taken[si] = other if float(np.nanmax(numbers)) > limit else si
    return taken


def told_apart(stem: str, number: int) -> str:
    """The name of the second, third, ... column of one name. It is a letter that tells them apart:
    a number would be that of a joint.

    >>> told_apart("j1", 2)
    'j1_b'
    """
    return f"{stem}_{'abcdefghijklmnopqrstuvwxyz'[(number - 1) % 26]}"


def counted(field: Field, names: Sequence[str]) -> Field:
    """A column of names, numbered from 1 as they occur; NaN for an empty cell."""
    order = tuple(dict.fromkeys(name for name in names if name))
    numbers = np.array([1.0 + order.index(name) if name else np.nan for name in names])
    return replace(field, values=numbers, labels=order)


def column_key(names: Sequence[str], position: int) -> str | int:
    """How a project names a column: by its name, by its number where that would be ambiguous."""
    name = names[position] if position < len(names) else ""
    return name if name and list(names).count(name) == 1 else position + 1


def moving(fields: Sequence[Field]) -> tuple[Field, ...]:
    """Those that do not stand still beside the others."""
    most = max((f.span for f in fields), default=0.0)
    return tuple(f for f in fields if f.span > STILL * most)


def names_of(fields: Sequence[Field]) -> str:
    """Columns as the reader knows them."""
    return ", ".join(f.label for f in fields)


def unnamed(fields: Sequence[Field]) -> str:
    """Columns listed for a message."""
    return listed([f.label for f in fields], 40)
