"""The [simulation] table of a project: which poses, which true machine, which noise."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError
from loopcal.files.project.names import DEVIATING, PARAMETER, RANGED, followers
from loopcal.files.project.noise_table import NOISE, Noises, StatedNoise, noises
from loopcal.files.project.plan_table import SPAN, reversed_range
from loopcal.files.toml.place import Place
from loopcal.keys import CONTEXT, Key, Made
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameters
from loopcal.simulation.poses import grid_poses, random_poses, stream

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

    @property
    def span(self) -> tuple[float, float]:
        """From its first value to its last."""
        last = self.start + self.step * (self.count - 1) if self.step else self.stop
        return self.start, last


@dataclass(frozen=True)
class SimulationSettings:
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
    noise: Noises
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
        # Drawn for all parameters, perturbed or not: what one of them gets depends on no other.
        draws = stream(seed, "machine").standard_normal(len(parameters))
        for parameter, z in zip(parameters, draws.tolist(), strict=True):
            sd = self.perturb.get(parameter.name)
            if sd is not None:
                truth[parameter.name] = truth.get(parameter.name, parameter.nominal) + sd * z
        return truth


def driven_range(
    from_: Annotated[float, Key("Smallest value.", unit=CONTEXT, beside=True)],
    to: Annotated[float, Key("Largest value.", unit=CONTEXT, beside=True)],
    step: Annotated[
        float | None,
        Key(
            "With steps all combinations are simulated, without random poses.",
            unit=CONTEXT,
            beside=True,
            difference=True,
            positive=True,
        ),
    ] = None,
    unit: Annotated[str | None, Key("Of these numbers.", is_unit=True)] = None,
) -> Range:
    """Where a quantity is driven in a simulation."""
    if to < from_:
        raise reversed_range(from_, to)
    # the last step counts although 0.1 * 10 may round to more than 1
    count = 1 if step is None else math.floor(min((to - from_) / step, 1e15) + 1e-9) + 1
    return Range(from_, to, step, count)


def spread(
    sd: Annotated[
        float, Key("Standard deviation.", unit=CONTEXT, beside=True, sd=True, alone=True)
    ],
    unit: Annotated[str | None, Key("Of the sd.", is_unit=True)] = None,
) -> float:
    """An sd with its unit."""
    if not math.isfinite(sd):
        raise InputError(
            "the deviation is infinite", code="invalid-value", remedy="give a finite sd"
        )
    return sd


@dataclass(frozen=True)
class SharedSimulation:
    """How `loopcal simulate` makes readings: poses, the true machine, the noise."""

    poses: Annotated[int | None, Key("How many random poses.", low=1)] = None
    ranges: Annotated[
        Mapping[str, Annotated[Range, Made(driven_range)]],
        Key(
            "Of every quantity that is driven, and of known constants.", names=RANGED, example=SPAN
        ),
    ] = field(default_factory=dict)
    truth: Annotated[
        Mapping[str, float],
        Key(
            "True values of parameters, by name or glob; else the nominal ones.",
            unit=CONTEXT,
            names=PARAMETER,
        ),
    ] = field(default_factory=dict)
    perturb: Annotated[
        Mapping[str, Annotated[float, Made(spread)]],
        Key(
            "sd of a random deviation of the truth from nominal, by name or glob.", names=DEVIATING
        ),
    ] = field(default_factory=dict)
    noise: Annotated[
        Mapping[str, StatedNoise],
        replace(NOISE, says="The true noise, where it is not what [noise] says."),
    ] = field(default_factory=dict)

    def settings(self, mechanism: Mechanism, noise: Noises, place: Place) -> SimulationSettings:
        """How readings are made by an estimator that assumes `noise`.

        Raises InputError for what does not fit the mechanism.
        """
        stated = noises(self.noise, mechanism, place.at("noise"))
        if stated.columns:
            raise InputError(
                "a covariance from columns of the data cannot be simulated",
                code="unsupported",
                place=stated.columns[0].place,
                remedy="give a covariance that is the same in all poses",
            )
        poses = self._grid_size(place)
        poses = self.poses if poses is None else poses
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
                place=str(place.at("ranges" if self.grid else "poses")),
                remedy="use larger steps or fewer poses",
            )
        return SimulationSettings(
            poses,
            self.grid,
            self.ranges,
            self.truth,
            self.perturb,
            noise.followed_by(stated),
            self._missing(mechanism),
            str(place.at("ranges")),
        )

    @property
    def grid(self) -> bool:
        """Whether all combinations of the ranges' values are simulated."""
        return any(r.step is not None for r in self.ranges.values())

    def _grid_size(self, place: Place) -> int | None:
        """How many poses a grid has; None where poses are random."""
        if not self.grid:
            return None
        single = [n for n, r in self.ranges.items() if r.step is None and r.start != r.stop]
        if single:
            raise InputError(
                "some ranges have a step, but this one has none",
                code="conflicting-keys",
                place=str(place.at("ranges", single[0])),
                remedy="give every range a step for a grid, or none for random poses",
            )
        count = math.prod(r.count for r in self.ranges.values())
        if self.poses not in (None, count):
            raise InputError(
                f"poses is {self.poses}, but the grid of all steps has {count} poses",
                code="conflicting-keys",
                place=str(place.at("poses")),
                remedy="remove poses for a grid, or the steps for random poses",
            )
        return count

    def _missing(self, mechanism: Mechanism) -> str | None:
        """A quantity that should have a range and has none."""
        elsewhere = {*followers(mechanism), *mechanism.implied, *mechanism.home, *self.ranges}
        missing = [
            n for n in (*mechanism.quantities, *mechanism.pose_constants) if n not in elsewhere
        ]
        needed = missing and (mechanism.outputs or missing[0] in mechanism.pose_constants)
        return missing[0] if needed else None


@dataclass(frozen=True)
class SimulationTable(SharedSimulation):
    """How `loopcal simulate` makes readings: poses, the true machine, the noise."""

    ranges: Annotated[
        Mapping[str, Annotated[Range, Made(driven_range)]],
        Key(
            "Of every quantity that is driven, and of known constants.",
            names=RANGED,
            least=1,
            example=SPAN,
        ),
    ] = field(kw_only=True)
