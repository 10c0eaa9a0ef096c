"""Noise as project files state it, turned into SI; covariances by pose wait for their columns."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.machines.parameter_entries import in_si
from loopcal.files.project.datasheet_entries import sd_of, tracker_of
from loopcal.files.toml.place import Place
from loopcal.measurements.noise import MODEL, Noise
from loopcal.units import unit

if TYPE_CHECKING:
    from loopcal.files.project.project_schema import NoiseEntry

Array = NDArray[np.float64]
Expand = Callable[[str], tuple[str, ...]]


@dataclass(frozen=True)
class CovarianceColumns:
    """A covariance of some quantities that stands in columns of the data, one per pose."""

    quantities: tuple[str, ...]
    columns: tuple[str | int, ...]
    factor: float
    """To SI: the square of the unit's factor."""
    place: str

    def matrices(self, values: Array) -> Array:
        """(N, b, b) [SI squared] from the columns' values (c, N)."""
        size = len(self.quantities)
        if len(self.columns) == size * size:
            return np.ascontiguousarray(values.T.reshape(-1, size, size)) * self.factor
        full = np.empty((values.shape[1], size, size))
        for row, i, j in zip(values, *np.triu_indices(size), strict=True):
            full[:, i, j] = full[:, j, i] = row * self.factor
        return full


@dataclass(frozen=True)
class NoiseSpec:
    """What is said about the sensors, in order: (quantities or quantity, sd or covariance [SI])."""

    entries: tuple[tuple[str | tuple[str, ...], Any], ...] = ()
    estimate: tuple[tuple[str | tuple[str, ...], str], ...] = ()
    """What is to be learnt: (key or quantities, "each" or "group")."""

    @property
    def columns(self) -> tuple[CovarianceColumns, ...]:
        """The covariances that have to be read with the data."""
        return tuple(v for _, v in self.entries if isinstance(v, CovarianceColumns))

    def sd_of(self, quantity: str) -> float | None:
        """The sd [SI] stated for a quantity as a whole, None if none or by covariance."""
        found = None
        for key, value in self.entries:
            if key == quantity:
                found = float(value)
            elif isinstance(key, tuple) and quantity in key:
                found = None
        return found

    def followed_by(self, other: NoiseSpec) -> NoiseSpec:
        """These entries and then the others, which win."""
        stated = {q for k, _ in other.entries for q in _names(k)}
        kept = [(k, v) for k, v in self.entries if not stated.issuperset(_names(k))]
        return NoiseSpec((*kept, *other.entries), self.estimate + other.estimate)

    def noise(self, covariances: Mapping[tuple[str, ...], Array] | None = None) -> Noise:
        """The noise, with the covariances (N, b, b) of the columns that were read.

        Raises InputError where a covariance by pose is stated and none was read.
        """
        made: dict[str | tuple[str, ...], Any] = {}
        for key, value in self.entries:
            if isinstance(value, CovarianceColumns):
                if covariances is None or value.quantities not in covariances:
                    raise InputError(
                        "a covariance from columns of the data cannot be simulated",
                        code="unsupported",
                        place=value.place,
                        remedy="state the noise of the simulation in [simulation.noise]",
                    )
                value = covariances[value.quantities]
            made.pop(key, None)  # the later line shall also stand later
            made[key] = value
        return Noise(made, estimate=dict(self.estimate))


def _names(key: str | tuple[str, ...]) -> tuple[str, ...]:
    return key if isinstance(key, tuple) else (key,)


def noise_spec(
    entries: Mapping[str, NoiseEntry], units: Mapping[str, str], expand: Expand, place: Place
) -> NoiseSpec:
    """The noise of a table; units: quantity -> SI unit, expand: a name, glob or group -> names.

    Raises InputError for unknown quantities, units that do not fit, and matrices that are none.
    """
    found: list[tuple[str | tuple[str, ...], Any]] = []
    learnt: list[tuple[str | tuple[str, ...], str]] = []
    for key, entry in entries.items():
        here = place.at(key)
        if key == MODEL:
            names: tuple[str, ...] = (MODEL,)
            units = {**units, MODEL: unit(entry.unit).si if entry.unit else "m"}
        else:
            names = _quantities(key, expand, here)
        if entry.estimate is not None:
            learnt.append((key if "," not in key else names, entry.estimate))
        kind = _kind(entry, here)
        if kind == "scalar":
            found += [(n, sd_of(entry, units[n], here)) for n in names]
        elif kind == "tracker":
            found.append((names, tracker_of(entry, names, units, here)))
        else:
            found.append((names, _covariance(entry, names, units, here)))
    return NoiseSpec(tuple(found), tuple(learnt))


def _kind(entry: NoiseEntry, place: Place) -> str:
    """The one kind of noise that is stated: scalar, tracker, covariance, covariance_columns."""
    given = [k for k in ("sd", "encoder", "rounded_to") if getattr(entry, k) is not None]
    kinds = ["scalar"] if given else []
    if entry.tracker is not None:
        given, kinds = ["tracker", *given], ["tracker"]  # which says what it cannot go with
    elif entry.station is not None:
        raise InputError(
            "station needs a tracker",
            code="conflicting-keys",
            place=str(place.at("station")),
            remedy='name the tracker, say tracker = "leica-at500"',
        )
    wide = [k for k in ("covariance", "covariance_columns") if getattr(entry, k) is not None]
    if len(kinds + wide) != 1:
        raise InputError(
            f"{' and '.join(given + wide) or 'no sd'} is stated",
            code="missing-sd",
            place=str(place),
            remedy="give sd, encoder, rounded_to or tracker, or else covariance or "
            "covariance_columns",
        )
    return (kinds + wide)[0]


def _quantities(key: str, expand: Expand, place: Place) -> tuple[str, ...]:
    try:
        found = [name for part in key.split(",") for name in expand(part.strip())]
    except InputError as error:
        raise error.at(str(place)) from None
    return tuple(dict.fromkeys(found))


def _covariance(
    entry: NoiseEntry, names: tuple[str, ...], units: Mapping[str, str], place: Place
) -> Any:
    dimensions = {unit(units[name]).dimension for name in names}
    if len(dimensions) > 1 and entry.unit is not None:
        raise InputError(
            f"a covariance of {' and '.join(sorted(dimensions))} cannot be in {entry.unit}",
            code="wrong-unit",
            place=str(place.at("unit")),
            remedy="remove unit and give the covariance in SI (m, rad)",
        )
    for name in names:
        in_si(1.0, entry.unit, units[name], place.at("unit"))
    factor = unit(entry.unit).factor ** 2 if entry.unit else 1.0
    size = len(names)
    if entry.covariance_columns is not None:
        columns = tuple(entry.covariance_columns)
        if len(columns) not in (size * size, size * (size + 1) // 2):
            raise InputError(
                f"{len(columns)} columns are named for the covariance of {', '.join(names)}",
                code="invalid-covariance",
                place=str(place.at("covariance_columns")),
                remedy=f"name {size * (size + 1) // 2} (xx, xy, ..., from the diagonal to the "
                f"right) or {size * size} (row by row)",
            )
        return CovarianceColumns(names, columns, factor, str(place))
    assert entry.covariance is not None
    if [len(row) for row in entry.covariance] != [size] * size:
        raise InputError(
            f"the covariance of {', '.join(names)} is not {size} by {size}",
            code="invalid-covariance",
            place=str(place.at("covariance")),
            remedy=f"give {size} rows of {size} numbers",
        )
    matrix = np.array(entry.covariance) * factor
    try:
        Noise({names: matrix})
    except InputError as error:
        raise error.at(str(place.at("covariance"))) from None
    return matrix
