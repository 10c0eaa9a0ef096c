"""Sanity of readings before any fit: units that cannot be right, columns that say nothing.

What would mislead stops (InputError); what is only odd comes back as a `DataWarning`. The rules
look at one column each and at nothing but its numbers, so a machine can break them and be right:
a winch turns through many turns, a tracker sees a ship. Such quantities are `trusted`.

A column stops when a tenth or more of its readings lie where readings of that unit hardly go:
beyond two turns (4 pi) for rad, beyond 100 m for metres; or, for rad, when half of them lie
beyond 7, more than a wrist of +-1 turn can reach. Fewer such readings are single wild values,
and warn.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError
from loopcal.measurements.dataset import Dataset
from loopcal.units import convertible, from_si, unit

# SI unit -> (bound, share of the readings beyond it that stops), the widest bound first.
_BOUNDS = {"rad": ((4 * math.pi, 0.1), (7.0, 0.5)), "m": ((100.0, 0.1),)}
_COLDEST = 150.0
"""Temperature [K] below which no machine stands in a workshop."""
_LIKELY = {"rad": ("deg", "degrees"), "m": ("mm", "millimetres or inches")}


@dataclass(frozen=True)
class DataWarning:
    """Something odd about the readings that does not stop the work."""

    quantity: str | None
    """The quantity it is about; None when it is about whole poses."""
    message: str
    """What is odd, where, and what to do if it is not meant."""

    def __str__(self) -> str:
        return self.message


def check_dataset(
    dataset: Dataset,
    quantities: Mapping[str, str],
    *,
    trusted: Collection[str] = (),
    points: Iterable[Sequence[str]] = (),
) -> tuple[DataWarning, ...]:
    """What is odd about the readings of `quantities` (quantity -> unit the mechanism expects).

    Quantities that the dataset does not have are passed over, as are other columns of it.
    Those `trusted`, here or by `check = false` where they were read, are looked at for their
    unit's dimension only. points: the coordinates of each measured point.

    Raises InputError, with file, row and column, for a unit of another dimension and for a quantity
    without a reading. The same for degrees taken as rad, millimetres as m, and points of zeros.
    """
    check_units(dataset, quantities)
    sure = {*trusted, *dataset.source.trusted}
    suspects = {
        q: unit(u).si for q, u in quantities.items() if q in dataset.readings and q not in sure
    }
    for quantity, si in suspects.items():
        _stop_if_all_missing(dataset, quantity)
        _stop_if_far(dataset, quantity, si)
        _stop_if_cold(dataset, quantity, si)
    for point in points:
        if len(point) > 1 and all(q in suspects for q in point):
            right = f"if the point is right, set check = false for {point[0]!r}"
            refuse_lost(dataset, point, np.all(_zeros(dataset, point), axis=0), right)
    return (
        *_repeated_poses(dataset),
        *_empty_poses(dataset, [q for q in quantities if q in dataset.readings]),
        *_wild_values(dataset, suspects),
        *_suspiciously_small(dataset, suspects),
        *_constant(dataset, suspects),
        *_duplicated(dataset, suspects),
        *_partly_exact(dataset, suspects),
    )


def refuse_implausible(dataset: Dataset, quantities: Mapping[str, str]) -> None:
    """Raise InputError for degrees taken as rad, millimetres as m, and degC as K.

    quantities: quantity -> unit the mechanism expects, of those without a stated unit.
    """
    for quantity, si in quantities.items():
        if quantity in dataset.readings and not np.isnan(dataset.readings[quantity]).all():
            _stop_if_far(dataset, quantity, si)
            _stop_if_cold(dataset, quantity, si)


def cold_as_kelvin(value: float, si: str | None) -> bool:
    """Whether a temperature [K] is colder than any workshop, so that it looks like degC."""
    return si == "K" and bool(value < _COLDEST)


def check_units(dataset: Dataset, quantities: Mapping[str, str]) -> None:
    """Raise InputError where a stated unit has another dimension than the mechanism's."""
    for quantity, expected in quantities.items():
        stated = dataset.source.stated.get(quantity, dataset.units.get(quantity))
        if stated is not None and not convertible(stated, expected):
            raise InputError(
                f"{quantity!r} is in {stated} ({unit(stated).dimension}), but the mechanism "
                f"expects {unit(expected).dimension} ({expected})",
                code="wrong-unit",
                place=_column(dataset, quantity),
                remedy=f"state a unit of {unit(expected).dimension}, or map another column",
            )


def refuse_lost(
    dataset: Dataset, names: Sequence[str], lost: NDArray[np.bool_], otherwise: str
) -> None:
    """Raise InputError for poses (N,) in which these quantities read 0 for a lost reflector.

    otherwise: what else to do.
    """
    where = np.flatnonzero(lost)
    if where.size:
        raise InputError(
            f"{', '.join(names)} all read 0 in {where.size} of {len(dataset)} poses "
            f"({_few([dataset.poses[i] for i in where])}): instruments write 0 for a lost "
            f"reflector",
            code="lost-reflector",
            place=dataset.place(int(where[0]), names[0]),
            remedy=f"blank these cells; {otherwise}",
        )


def lost_rows(dataset: Dataset) -> tuple[tuple[str, ...], NDArray[np.bool_]]:
    """Of repeated readings of one pose: quantities that drop to 0 together, and in which rows."""
    names = tuple(q for q in dataset.quantities if _far_from_zero(dataset.readings[q]))
    zeros = _zeros(dataset, names)
    lost: NDArray[np.bool_] = zeros.sum(axis=0) > 1
    return tuple(q for q, zero in zip(names, zeros, strict=True) if zero[lost].any()), lost


def _far_from_zero(values: Array) -> bool:
    """Whether all that is not exactly 0 scatters far away from it."""
    others = values[~np.isnan(values) & (values != 0.0)]
    return others.size > 1 and 0.0 < float(np.ptp(others)) < 0.1 * float(np.abs(others).min())


def _zeros(dataset: Dataset, names: Sequence[str]) -> NDArray[np.bool_]:
    """(n, N): which of the readings are exactly 0."""
    return np.array([dataset.readings[q] == 0.0 for q in names]).reshape(len(names), len(dataset))


def _stop_if_all_missing(dataset: Dataset, quantity: str) -> None:
    if np.isnan(dataset.readings[quantity]).all():
        raise InputError(
            f"{quantity!r} has no reading in any of {len(dataset)} poses",
            code="no-data",
            place=_column(dataset, quantity),
            remedy="map its column, or remove it if it was not measured",
        )


def _stop_if_far(dataset: Dataset, quantity: str, si: str) -> None:
    if _stated(dataset, quantity, si) != si:
        return
    values = dataset.readings[quantity]
    size = np.abs(values[~np.isnan(values)])
    for bound, share in _BOUNDS.get(si, ()):
        beyond = size > bound
        # Single wild values are outliers, not a wrong unit; `_wild_values` names them.
        if beyond.mean() < share:
            continue
        index = int(np.nanargmax(np.abs(values)))
        likely, looks = _LIKELY[si]
        taken = "declared" if quantity in dataset.source.stated else "taken as"
        raise InputError(
            f"{quantity!r} reads {values[index]:.6g} and is {taken} {si}: {beyond.sum()} of "
            f"{size.size} readings lie beyond {bound:.3g} {si}; they look like {looks}",
            code="implausible-unit",
            place=_value(dataset, index, quantity),
            remedy=_other_unit(dataset, quantity, likely, si),
        )


def _stop_if_cold(dataset: Dataset, quantity: str, si: str) -> None:
    """Raise InputError for temperatures in K that look like degC: their zero would be 273 K off."""
    values = dataset.readings[quantity]
    if _stated(dataset, quantity, si) != "K" or not cold_as_kelvin(np.nanmax(values), si):
        return
    index = int(np.nanargmax(values))
    raise InputError(
        f"{quantity!r} reads at most {values[index]:.6g} K: these look like degC",
        code="implausible-unit",
        place=_value(dataset, index, quantity),
        remedy=f'state unit = "degC"; if K is right, set check = false for {quantity!r}',
    )


def _other_unit(dataset: Dataset, quantity: str, likely: str, si: str) -> str:
    """What to do: in a project, or in Python where the readings have no file."""
    if not dataset.source.name:
        return f'give units={{"{quantity}": "{likely}"}}, or "{si}" if {si} is right'
    return f'state unit = "{likely}"; if {si} is right, set check = false for {quantity!r}'


def _repeated_poses(dataset: Dataset) -> Iterator[DataWarning]:
    seen: set[str] = set()
    repeated: dict[str, None] = {}
    for pose in dataset.poses:
        if pose in seen:
            repeated[pose] = None
        seen.add(pose)
    if repeated:
        yield DataWarning(
            None,
            f"pose ids that occur more than once: {_few(list(repeated))}; "
            "excluding one excludes all of its rows",
        )


def _empty_poses(dataset: Dataset, quantities: list[str]) -> Iterator[DataWarning]:
    if not quantities:
        return
    empty = np.logical_and.reduce([np.isnan(dataset.readings[q]) for q in quantities])
    names = [dataset.poses[i] for i in np.flatnonzero(empty)]
    if names:
        yield DataWarning(None, f"poses without any reading: {_few(names)}")


def _wild_values(dataset: Dataset, suspects: Mapping[str, str]) -> Iterator[DataWarning]:
    for quantity, si in suspects.items():
        values = np.abs(dataset.readings[quantity])
        index = int(np.nanargmax(values))
        if si in _BOUNDS and values[index] > _BOUNDS[si][0][0]:
            yield DataWarning(
                quantity,
                f"{_value(dataset, index, quantity)}: {quantity!r} reads "
                f"{dataset.readings[quantity][index]:.6g} {si}, beyond {_BOUNDS[si][0][0]:.3g}; "
                "exclude the pose if this is an error",
            )


def _suspiciously_small(dataset: Dataset, suspects: Mapping[str, str]) -> Iterator[DataWarning]:
    """Declared deg (or mm), but every such column lies within what rad (or m) would give.

    All columns of one unit are looked at together: a machine logs them alike, and one joint
    that hardly moves among others that do is no reason to doubt.
    """
    for declared, meant, bound, spread in (("deg", "rad", 2 * math.pi, 0.5), ("mm", "m", 10, 0.05)):
        group = [q for q, si in suspects.items() if _stated(dataset, q, si) == declared]
        columns = {q: _in_stated(dataset, q, unit(declared).si) for q in group}
        if not columns or max(np.nanmax(np.abs(v)) for v in columns.values()) > bound:
            continue
        for quantity, values in columns.items():
            if np.nanmax(values) - np.nanmin(values) >= spread:
                yield DataWarning(
                    quantity,
                    f"{_column(dataset, quantity)}: {quantity!r} is declared {declared}, and no "
                    f"reading in {declared} exceeds {np.nanmax(np.abs(values)):.6g}; "
                    f"are these {meant}?",
                )


def _constant(dataset: Dataset, suspects: Mapping[str, str]) -> Iterator[DataWarning]:
    for quantity in suspects:
        values = dataset.readings[quantity]
        read = values[~np.isnan(values)]
        if read.size > 1 and read.min() == read.max():
            stated_unit = _stated(dataset, quantity, suspects[quantity])
            yield DataWarning(
                quantity,
                f"{_column(dataset, quantity)}: {quantity!r} reads "
                f"{from_si(read[0], stated_unit):.6g} {stated_unit} in all of "
                f"{read.size} poses: its parameters may be undetermined",
            )


def _duplicated(dataset: Dataset, suspects: Mapping[str, str]) -> Iterator[DataWarning]:
    first: dict[bytes, str] = {}
    for quantity in suspects:
        values = dataset.readings[quantity]
        if np.nanmin(values) == np.nanmax(values):
            continue  # constant columns are equal easily, and have their warning
        other = first.setdefault((values + 0.0).tobytes(), quantity)
        if other != quantity:
            yield DataWarning(
                quantity,
                f"{_column(dataset, quantity)}: {quantity!r} reads the same as {other!r} in "
                "every pose; is one column copied or mapped twice?",
            )


def _partly_exact(dataset: Dataset, suspects: Mapping[str, str]) -> Iterator[DataWarning]:
    for quantity in suspects:
        sd = dataset.sds.get(quantity)
        if sd is None:
            continue
        # Beside a blank reading a blank sd is as good as any.
        read = ~np.isnan(dataset.readings[quantity])
        exact = np.flatnonzero((sd == 0) & read)
        if 0 < exact.size < read.sum():
            yield DataWarning(
                quantity,
                f"{dataset.place(int(exact[0]), quantity, sd=True)}: the sd of {quantity!r} is 0 "
                f"in {exact.size} of {len(dataset)} poses, which makes those readings exact; if "
                f"it was rounded to 0, give the smallest sd instead",
            )


def _stated(dataset: Dataset, quantity: str, si: str) -> str:
    """The unit that the readings came in, by its plain name."""
    return unit(dataset.source.stated.get(quantity, si)).name


def _in_stated(dataset: Dataset, quantity: str, si: str) -> Array:
    return from_si(dataset.readings[quantity], _stated(dataset, quantity, si))


def _value(dataset: Dataset, index: int, quantity: str) -> str:
    place = dataset.place(index, quantity)
    named = dataset.source.rows is None
    return place if named else f"{place} (pose {dataset.poses[index]!r})"


def _column(dataset: Dataset, quantity: str) -> str:
    column = dataset.source.columns.get(quantity)
    words = [dataset.source.name] if dataset.source.name else []
    words.append(f"column {column!r}" if column else f"quantity {quantity!r}")
    return ", ".join(words)


def _few(names: list[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
