"""The [simulation] table of a project: which poses, which true machine, which noise."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, nearest
from loopcal.files.machines.parameter_entries import in_si
from loopcal.files.project.noise_entries import NoiseSpec, noise_spec
from loopcal.files.toml.place import Place
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameters
from loopcal.simulation.poses import grid_poses, random_poses, stream

if TYPE_CHECKING:
    from loopcal.files.project.project_schema import SimulationEntry

MOST_POSES = 100_000_000


@dataclass(frozen=True)
class Range:
    """Where a quantity is driven [SI]: anywhere from start to stop, or in `count` steps."""

    start: float
    stop: float
    step: float | None = None
    count: int = 1

    @property
    def values(self) -> NDArray[np.float64]:
        """The grid (count,), the first alone where there are no steps."""
        steps = np.arange(self.count, dtype=np.float64)
        return self.start + (self.step or 0.0) * steps


@dataclass(frozen=True)
class SimulationSpec:
    """How readings are made, SI.

    poses: how many; grid: whether they are all combinations of the ranges' values, or random;
    ranges: quantity or known constant -> range; truth: parameter -> true value, where it is not
    the nominal one; perturb: parameter -> sd of a random deviation of its truth, fixed parameters
    never among them; noise: of the sensors, as they truly are; missing: a quantity that should
    have a range and has none; place: of the ranges in the file.
    """

    poses: int
    grid: bool
    ranges: Mapping[str, Range]
    truth: Mapping[str, float]
    perturb: Mapping[str, float]
    noise: NoiseSpec
    missing: str | None = None
    place: str = ""

    def refuse_missing(self) -> None:
        """InputError where a quantity has no range: whoever only calibrates need not care."""
        if self.missing is not None:
            raise InputError(
                f"no range is given for {self.missing!r}",
                code="missing-key",
                place=self.place,
                remedy=f"add {self.missing} = {{ from = ..., to = ..., unit = ... }}",
            )

    def driven(self, seed: int) -> dict[str, NDArray[np.float64]]:
        """Where the driven quantities stand [SI]; the seed chooses where there is no grid."""
        self.refuse_missing()
        if self.grid:
            return grid_poses({name: span.values for name, span in self.ranges.items()})
        ranges = {name: (span.start, span.stop) for name, span in self.ranges.items()}
        return random_poses(ranges, self.poses, seed=seed)

    def machine(self, parameters: Parameters, seed: int) -> dict[str, float]:
        """The truth that is stated [SI], and random deviations where these are asked for."""
        truth = dict(self.truth)
        draws = stream(seed, "machine").standard_normal(len(parameters))
        for parameter, z in zip(parameters, draws.tolist(), strict=True):
            sd = self.perturb.get(parameter.name)
            if sd is not None:
                truth[parameter.name] = truth.get(parameter.name, parameter.nominal) + sd * z
        return truth


def simulation_spec(
    entry: SimulationEntry, mechanism: Mechanism, noise: NoiseSpec, place: Place
) -> SimulationSpec:
    """The simulation of a project whose estimator is told `noise`.

    Raises InputError for names, units and ranges that do not fit the mechanism.
    """
    ranges, missing = _ranges(entry, mechanism, place.at("ranges"))
    grid = any(r.step is not None for r in ranges.values())
    poses = entry.poses
    if grid:
        single = [name for name, r in ranges.items() if r.step is None and r.start != r.stop]
        if single:
            raise InputError(
                "some ranges have a step, but this one has none",
                code="conflicting-keys",
                place=str(place.at("ranges", single[0])),
                remedy="give every range a step for a grid, or none for random poses",
            )
        count = math.prod(r.count for r in ranges.values())
        if poses not in (None, count):
            raise InputError(
                f"poses is {poses}, but the grid of all steps has {count} poses",
                code="conflicting-keys",
                place=str(place.at("poses")),
                remedy="remove poses for a grid, or the steps for random poses",
            )
        poses = count
    if poses is None:
        raise InputError(
            "the number of poses is missing",
            code="missing-key",
            place=str(place),
            remedy="add poses = 100, or give every range a step",
        )
    if poses > MOST_POSES:
        raise InputError(
            f"{poses} poses are more than the {MOST_POSES} that can be simulated",
            code="too-large",
            place=str(place.at("ranges" if grid else "poses")),
            remedy="use larger steps or fewer poses",
        )
    told = noise_spec(
        entry.noise, mechanism.quantities, mechanism.quantity_group, place.at("noise")
    )
    if told.columns:
        raise InputError(
            "a covariance from columns of the data cannot be simulated",
            code="unsupported",
            place=told.columns[0].place,
            remedy="give a covariance that is the same in all poses",
        )
    truth, perturb = _machine(entry, mechanism, place)
    here = str(place.at("ranges"))
    return SimulationSpec(
        poses, grid, ranges, truth, perturb, noise.followed_by(told), missing, here
    )


def _ranges(
    entry: SimulationEntry, mechanism: Mechanism, place: Place
) -> tuple[dict[str, Range], str | None]:
    """The ranges by quantity, and one that is missing."""
    units = {**mechanism.quantities, **mechanism.known}
    read = {n for o in mechanism.orientations for n in (*o.columns, *o.turns)}
    read |= {*mechanism.outputs}
    found = {}
    for name, given in entry.ranges.items():
        here = place.at(name)
        if name not in units or name in read:
            driven = [n for n in units if n not in read and n not in mechanism.implied]
            follows = "follows from the loops" if name in units else "is no quantity"
            raise InputError(
                f"{name!r} {follows} of the mechanism",
                code="unknown-name",
                place=str(here),
                remedy=f"give the ranges of {', '.join(driven)}"
                if name in units
                else nearest(name, driven),
            )
        at = here.at("unit")
        if given.to < given.from_:
            raise InputError(
                f"the range goes from {given.from_:g} to {given.to:g}",
                code="invalid-value",
                place=str(here),
                remedy="give the smaller number first",
            )
        si, step, count = units[name], None, 1
        start, stop = (in_si(v, given.unit, si, at) for v in (given.from_, given.to))
        if given.step is not None:
            # the last step counts although 0.1 * 10 may round to more than 1
            count = math.floor(min((given.to - given.from_) / given.step, 1e15) + 1e-9) + 1
            step = in_si(given.step, given.unit, si, at, difference=True)
        found[name] = Range(start, stop, step, count)
    elsewhere = {*read, *mechanism.implied, *mechanism.home}
    missing = [n for n in units if n not in found and n not in elsewhere]
    if missing and (mechanism.outputs or missing[0] in mechanism.known):
        return found, missing[0]
    return found, None


def _machine(
    entry: SimulationEntry, mechanism: Mechanism, place: Place
) -> tuple[dict[str, float], dict[str, float]]:
    """True values, and sds of random deviations, by parameter [SI]."""
    parameters = mechanism.parameters
    truth: dict[str, float] = {}
    perturb: dict[str, float] = {}

    def names(key: str, here: Place) -> tuple[str, ...]:
        try:
            return parameters.matching(key)
        except InputError as error:
            raise error.at(str(here)) from None

    for key, given in entry.truth.items():
        here = place.at("truth", key)
        for name in names(key, here):
            truth[name] = in_si(given.value, given.unit, parameters[name].unit, here.at("unit"))
    for key, spread in entry.perturb.items():
        here = place.at("perturb", key)
        for name in names(key, here):
            sd = in_si(
                spread.sd, spread.unit, parameters[name].unit, here.at("unit"), difference=True
            )
            if not math.isfinite(sd):
                raise InputError(
                    "the deviation is infinite",
                    code="invalid-value",
                    place=str(here),
                    remedy="give a finite sd",
                )
            if not parameters[name].fixed:
                perturb[name] = sd
            elif name == key:
                raise InputError(
                    f"{name!r} is fixed, so it cannot deviate",
                    code="conflicting-keys",
                    place=str(here),
                    remedy="free it, or state its true value in [simulation.truth]",
                )
    return truth, perturb
