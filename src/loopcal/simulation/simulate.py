"""Simulation: what the sensors of a mechanism with known parameters would read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loopcal.arrays import Array
from loopcal.errors import InputError, unknown_name
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, NoiseLike, ReadingUncertainty, resolve_noise
from loopcal.measurements.source import Source
from loopcal.mechanisms.instruments.orientation import Orientation
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.simulation.closing import close_loops, closed_within, reachable
from loopcal.simulation.poses import measured, parallel, stream, unstated_orientations


@dataclass(frozen=True, eq=False, repr=False)
class Simulation:
    """Readings with noise, and the truth behind them.

    dataset: what the sensors read; parameters: every true parameter by name [SI]; quantities:
    true value (N,) [SI] of every quantity, without noise; seed: of the noise.
    """

    dataset: Dataset
    parameters: Mapping[str, float]
    quantities: Mapping[str, Array]
    seed: int

    def __repr__(self) -> str:
        return f"<Simulation: {len(self.dataset)} poses, seed {self.seed}>"


def simulate(
    mechanism: Mechanism,
    readings: Mapping[str, ArrayLike] | Dataset | Any,
    *,
    noise: NoiseLike | None = None,
    seed: int,
    truth: Mapping[str, float] | None = None,
    start: Mapping[str, ArrayLike] | None = None,
) -> Simulation:
    """Readings of a mechanism in given poses, with noise of a known seed.

    readings: true values of the driven quantities and known constants, as a dict of (N,) arrays
    [SI], any DataFrame or a Dataset. The outputs, and whatever is not given, follow from closing
    the loops f(x, p) = 0 at the true parameters p: the nominal ones, replaced by those in
    `truth` [SI]. Outputs that are given only say where that search starts, as `start` does for
    other quantities (one value, or one per pose); without either it starts at the mechanism's
    home. A quantity with an implied reading has that reading, and is truly off by its noise, unless
    it is given. An orientation of
    which no number is given is simulated: its noise is in the numbers that were read.

    reading = true value + sd * z, z standard normal and independent. PCG64 draws z from the seed in
    the order of the mechanism's quantities, whatever the sds: another sd scales the same draw. A
    full covariance takes its square root for the sd. With sd 0 the reading is the truth, with sd
    inf there is none (NaN).

    >>> from loopcal.mechanisms.planar import planar_two_link
    >>> exact = Noise({"*": 0.0})
    >>> made = simulate(planar_two_link(), {"phi2": [0.0], "phi3": [0.0]}, noise=exact, seed=1)
    >>> made.dataset["xP"]
    array([1.4])

    Raises InputError for names that are not the mechanism's, values that are missing, and poses
    whose loops cannot close.
    """
    sensor_noise = Noise.of(noise)
    if sensor_noise is None:
        raise InputError(
            "no noise is given",
            code="missing-sd",
            remedy='give Noise({"*": 0.0}) for exact readings',
        )
    driven = readings if isinstance(readings, Dataset) else Dataset.from_arrays(readings)
    unturned = unstated_orientations(mechanism, driven)
    driven = driven.with_readings(parallel(unturned, len(driven)))
    parameters = {p.name: p.nominal for p in mechanism.parameters.with_nominal(truth or {})}
    x, unknown = _values(mechanism, driven, start or {})
    pose_constants = _pose_constants(mechanism, driven)
    values = np.array(list(parameters.values()))
    true = close_loops(mechanism, values, x, pose_constants, unknown, driven.poses)
    constants = dict(zip(mechanism.tape.pose_constants, pose_constants, strict=True))
    gaps = [q for q in mechanism.implied if q not in driven.readings and q not in unknown]
    if gaps:
        exact = _exact(mechanism, driven, true, constants)
        rows = [mechanism.tape.quantities.index(q) for q in gaps]
        # Such a reading is fixed: the truth is off by the noise, so the draw is taken from the
        # truth.
        true[rows] -= np.nan_to_num(
            _draw(_sds(mechanism, exact, sensor_noise), true.shape, seed)[rows]
        )
        true = close_loops(mechanism, values, true, pose_constants, unknown, driven.poses)
    dataset = _read(mechanism, driven, true, constants, unturned, sensor_noise, seed)
    quantities = dict(zip(mechanism.tape.quantities, true, strict=True))
    for row in quantities.values():
        row.setflags(write=False)
    return Simulation(
        dataset, MappingProxyType(parameters), MappingProxyType(quantities), int(seed)
    )


def within_reach(
    mechanism: Mechanism, readings: Mapping[str, ArrayLike] | Dataset | Any
) -> NDArray[np.bool_]:
    """(N,) the poses whose loops close at the nominal parameters; readings as of `simulate`."""
    driven = readings if isinstance(readings, Dataset) else Dataset.from_arrays(readings)
    driven = driven.with_readings(parallel(unstated_orientations(mechanism, driven), len(driven)))
    x, unknown = _values(mechanism, driven, {})
    values = np.array([p.nominal for p in mechanism.parameters])
    return reachable(mechanism, values, x, _pose_constants(mechanism, driven), unknown)


def moved_to_close(
    mechanism: Mechanism,
    readings: Mapping[str, ArrayLike] | Dataset | Any,
    free: Mapping[str, tuple[ArrayLike, ArrayLike]],
) -> tuple[dict[str, Array], NDArray[np.bool_]]:
    """The quantities that are free, moved within their spans [SI] until the loops close at the
    nominal parameters, and (N,) whether they do; readings as of `simulate`."""
    driven = readings if isinstance(readings, Dataset) else Dataset.from_arrays(readings)
    driven = driven.with_readings(parallel(unstated_orientations(mechanism, driven), len(driven)))
    x, _ = _values(mechanism, driven, {})
    values = np.array([p.nominal for p in mechanism.parameters])
    constants = _pose_constants(mechanism, driven)
    closed, closes = closed_within(mechanism, values, x, constants, free)
    return {q: closed[mechanism.tape.quantities.index(q)] for q in free}, closes


def _read(
    mechanism: Mechanism,
    driven: Dataset,
    true: Array,
    constants: Mapping[str, Array],
    simulated: Sequence[Orientation],
    noise: Noise,
    seed: int,
) -> Dataset:
    """Noisy readings of true values (k, N); the turns of a simulated orientation become small."""
    names = mechanism.tape.quantities
    exact = _exact(mechanism, driven, true, constants)
    drawn = _draw(_sds(mechanism, exact, noise), true.shape, seed)
    columns: dict[str, Array] = {}
    for orientation in simulated:
        rows = [names.index(turn) for turn in orientation.turns]
        reading = measured(orientation, true[rows], drawn[rows])
        true[rows] = reading.off
        columns |= reading.columns
    return exact.with_readings(
        {**dict(zip(names, true + drawn, strict=True)), **columns}, units=mechanism.quantities
    )


def _exact(
    mechanism: Mechanism, driven: Dataset, true: Array, constants: Mapping[str, Array]
) -> Dataset:
    """The true values (k, N) as a data set."""
    quantities = dict(zip(mechanism.tape.quantities, true, strict=True))
    return Dataset(
        {**quantities, **constants},
        mechanism.units,
        driven.poses,
        # no sd beside a lost reading: it is lost in the simulation too
        {q: np.where(np.isnan(sd), np.inf, sd) for q, sd in driven.sds.items() if q in quantities},
        Source(rows_read=len(driven)),
    )


def _sds(mechanism: Mechanism, exact: Dataset, noise: Noise) -> ReadingUncertainty:
    return resolve_noise(noise, exact, mechanism.tape.quantities, mechanism.quantity_group)


def _values(
    mechanism: Mechanism, driven: Dataset, start: Mapping[str, ArrayLike]
) -> tuple[Array, list[str]]:
    """All quantities (k, N), start values where they are to be found, and which these are."""
    names = mechanism.tape.quantities
    for key in [*driven.quantities, *start]:
        if key not in (*names, *mechanism.tape.pose_constants):
            raise unknown_name(
                f"{key!r} is not a quantity of {mechanism.name!r}",
                key,
                [*names, *mechanism.tape.pose_constants],
            )
    turns = {turn for orientation in mechanism.orientations for turn in orientation.turns}
    x = np.zeros((len(names), len(driven)))
    unknown = []
    for row, name in zip(x, names, strict=True):
        stated: ArrayLike | None = driven.readings.get(name, mechanism.implied.get(name))
        if stated is None and name in mechanism.disturbances:
            stated = 0.0  # of the machine model itself, as in candidates of a plan
        sought = name in mechanism.outputs or name in turns or stated is None
        if sought:
            unknown.append(name)
        begin = start.get(name, mechanism.home.get(name, 0.0))
        values = np.asarray(begin if stated is None else stated, dtype=float)
        missing = np.isnan(np.broadcast_to(values, row.shape))
        if missing.any() and not sought:
            raise InputError(
                f"the driven quantity {name!r} has no value at pose "
                f"{driven.poses[int(np.argmax(missing))]!r}",
                code="missing-reading",
                remedy="give its true value in every pose, or omit the quantity if the loops "
                "determine it",
            )
        row[:] = np.where(missing, 0.0, values)
    return x, unknown


def _pose_constants(mechanism: Mechanism, driven: Dataset) -> Array:
    rows = [driven[name] for name in mechanism.tape.pose_constants]
    for name, row in zip(mechanism.tape.pose_constants, rows, strict=True):
        if np.isnan(row).any():
            raise InputError(
                f"the known constant {name!r} has no value at pose "
                f"{driven.poses[int(np.argmax(np.isnan(row)))]!r}",
                code="missing-reading",
                remedy="give its value in every pose",
            )
    return np.array(rows).reshape(len(rows), len(driven))


def _draw(uncertainty: ReadingUncertainty, shape: tuple[int, ...], seed: int) -> Array:
    """One draw of the noise (k, N) [SI]; NaN where a quantity is not read."""
    z = stream(seed, "noise").standard_normal(shape)
    noise = np.where(np.isinf(uncertainty.sd), np.nan, z)
    noise *= np.where(np.isinf(uncertainty.sd), 1.0, uncertainty.sd)
    for block in uncertainty.blocks:
        rows = list(block.indices)
        subscripts = "cd,db->cb" if block.factor.ndim == 2 else "bcd,db->cb"
        noise[rows] = np.einsum(subscripts, block.factor, z[rows])
    return noise
