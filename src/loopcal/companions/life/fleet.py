"""Machines of one type: what they have in common, which one is unusual, what the next one needs.

The true parameters of machine r are p_r ~ N(mu, Omega), Omega diagonal. Each parameter is learnt
by itself (`spread`). A machine is unusual where its parameters are improbable given mean and spread
of the others: p-values of its n parameters, each times n (Bonferroni), the least of them by Holm
(1979) over the machines. The next machine begins at the mean with the prior sd s_i of one more
machine; with the mean information L of a pose it knows after k poses

    C(k) = (k L + diag(1 / s_i^2))^-1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.companions.life.measured_machine import MeasuredMachine
from loopcal.companions.life.spread import LEVEL, Spread
from loopcal.errors import InputError, listed
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.presentation.shown import by_sd, chance, columns, size, unit_shown, wrapped

FEWEST = 3
"""Machines from which a spread is learnt."""
MACHINE_HEAD = ("machine", "poses", "p", "result")
# Fixed values that went through a file agree to nine digits.
_SAME = 1e-9


@dataclass(frozen=True)
class FleetParameter:
    """A parameter over the machines [SI].

    spread: sd between machines, its 95 % interval from low to high; low 0: only the bound is known.
    prior_sd: of the next machine, about the mean; alone, poses: how many poses the next machine
    needs for the sd that the results reached, without and with this prior.
    """

    name: str
    unit: str
    mean: float
    mean_sd: float
    spread: float
    low: float
    high: float
    prior_sd: float
    alone: int
    poses: int


@dataclass(frozen=True)
class Deviation:
    """Of a machine from the mean of the others [SI], its sd by its own readings, its chance."""

    parameter: str
    value: float
    sd: float
    p_value: float


@dataclass(frozen=True)
class FleetMachine:
    """p_value: adjusted for the number of parameters and machines; outstanding: parameters."""

    name: str
    poses: int
    deviations: tuple[Deviation, ...]
    p_value: float
    outstanding: tuple[str, ...]

    @property
    def unusual(self) -> bool:
        """Whether it differs from the others by more than chance explains."""
        return self.p_value < 1.0 - LEVEL


@dataclass(frozen=True)
class LeftOut:
    """A parameter that the machines cannot be compared in, and why."""

    name: str
    reason: str


@dataclass(frozen=True)
class Fleet:
    """Machines of one type: `loopcal.fleet`.

    fewest: poses with as many equations as a machine has parameters.
    """

    machine: str
    parameters: tuple[FleetParameter, ...]
    machines: tuple[FleetMachine, ...]
    left_out: tuple[LeftOut, ...]
    fewest: int

    @property
    def unusual(self) -> tuple[FleetMachine, ...]:
        """The machines that differ from the others."""
        return tuple(one for one in self.machines if one.unusual)

    @property
    def alone(self) -> int:
        """Poses that the next machine needs for every sd that the results reached, by itself."""
        return max(p.alone for p in self.parameters)

    @property
    def poses(self) -> int:
        """Poses that it needs where it begins from this fleet."""
        return max(p.poses for p in self.parameters)

    def started(self, mechanism: Mechanism) -> Mechanism:
        """A mechanism of this type that begins at the means, with the prior sds of the fleet."""
        means = {p.name: p.mean for p in self.parameters}
        begun = mechanism.with_nominal(means)
        sds = {p.name: p.prior_sd for p in self.parameters}
        return begun.with_parameters(begun.parameters.with_prior(sds))

    def document(self) -> dict[str, Any]:
        """As one JSON document: SI."""
        machines = [{**asdict(one), "unusual": one.unusual} for one in self.machines]
        poses = {"alone": self.alone, "with_fleet": self.poses, "fewest": self.fewest}
        return {**asdict(self), "machines": machines, "next_machine": poses}

    def __str__(self) -> str:
        lines = [f"{len(self.machines)} machines: {self.machine}", "", *columns(self._spreads())]
        lines += [
            "",
            *columns([MACHINE_HEAD, *self.machine_rows()]),
            "",
            "deviations from the mean of the other machines:",
        ]
        lines += columns(self._deviations())
        if self.left_out:
            lines += ["", *self._left_out()]
        return "\n".join([*lines, "", *wrapped(self._next())])

    def _spreads(self) -> list[list[str]]:
        rows = [["parameter", "mean", "spread", "95 % interval", "prior sd", "poses", "unit"]]
        for p in self.parameters:
            low, high = (size(v, p.unit, 2) for v in (p.low, p.high))
            between = f"{low} to {high}" if p.low > 0.0 else f"below {high}"
            mean = by_sd(p.mean, p.mean_sd, p.unit)
            sds = (size(p.spread, p.unit, 2), between, size(p.prior_sd, p.unit, 2))
            rows.append([p.name, mean, *sds, str(p.poses), unit_shown(p.unit)])
        return rows

    def machine_rows(self) -> list[tuple[str, ...]]:
        """Of each machine the cells under `MACHINE_HEAD`."""
        return [
            (
                one.name,
                str(one.poses),
                chance(one.p_value),
                f"unusual: {', '.join(one.outstanding)}" if one.unusual else "like the others",
            )
            for one in self.machines
        ]

    def _deviations(self) -> list[list[str]]:
        rows = [["parameter", *(one.name for one in self.machines), "unit"]]
        for i, p in enumerate(self.parameters):
            deviations = [one.deviations[i] for one in self.machines]
            shown = [by_sd(d.value, d.sd, p.unit, sign=True) for d in deviations]
            rows.append([p.name, *shown, unit_shown(p.unit)])
        return rows

    def _left_out(self) -> list[str]:
        by_reason: dict[str, list[str]] = {}
        for one in self.left_out:
            by_reason.setdefault(one.reason, []).append(one.name)
        return [
            line
            for reason, names in by_reason.items()
            for line in wrapped(f"left out: {', '.join(names)} ({reason})", then="  ")
        ]

    def _next(self) -> str:
        return (
            f"The next machine needs about {self.poses} poses for the sds that these results "
            f"reached if it starts from this fleet, and {self.alone} without it. This counts poses "
            "like those of these results, whose variances fall as the number of poses grows."
        )


def learn(machines: Sequence[MeasuredMachine]) -> Fleet:
    """The fleet of some machines.

    Raises InputError for fewer than three, for machines of several types or parameters, and where
    no parameter is known of every machine.
    """
    if len(machines) < FEWEST:
        raise InputError(
            f"there are {len(machines)} results, and a spread needs {FEWEST} machines",
            code="too-few-results",
            remedy="name the results of at least three machines of one type",
        )
    first = machines[0]
    for i, other in enumerate(machines[1:], 1):
        _check_alike(first, other)
        _check_apart(machines[:i], other)
    left_out = tuple(
        LeftOut(name, reason)
        for i, name in enumerate(first.names)
        if (reason := _reason(machines, i)) is not None
    )
    out = {one.name for one in left_out}
    at = np.array([i for i, name in enumerate(first.names) if name not in out], dtype=np.intp)
    if not len(at):
        raise InputError(
            "no parameter of the machine is estimated and determined in every result",
            code="no-free-parameter",
            remedy="calibrate the machines with the same free parameters and enough poses",
        )
    Y = _together(machines)[:, at]
    C = np.array([one.covariance[np.ix_(at, at)] for one in machines])
    names = [first.names[i] for i in at]
    V = np.einsum("rii->ri", C)
    spreads = [Spread.of(Y[:, i], V[:, i]) for i in range(len(at))]
    others = [[_without(s, r) for s in spreads] for r in range(len(machines))]
    fewest = max(one.fewest for one in machines)
    poses = np.array([one.poses for one in machines])
    alone, needed = _poses(C, poses, np.array([s.predictive_sd for s in spreads]), fewest)
    units = [first.mechanism.parameters[name].unit for name in names]
    return Fleet(
        first.mechanism.name,
        tuple(
            FleetParameter(
                name,
                unit,
                s.mean,
                s.mean_sd,
                s.sd,
                s.low,
                s.high,
                s.predictive_sd,
                poses_alone,
                poses_needed,
            )
            for name, unit, s, poses_alone, poses_needed in zip(
                names, units, spreads, alone.tolist(), needed.tolist(), strict=True
            )
        ),
        _judged(machines, names, Y, V, others),
        left_out,
        fewest,
    )


def _check_alike(first: MeasuredMachine, other: MeasuredMachine) -> None:
    """Raise InputError unless both are results of machines of one type."""

    def refuse(difference: str) -> InputError:
        return InputError(
            f"the results {first.name!r} and {other.name!r} are not of one type of machine: "
            f"{difference}",
            code="mismatched-machines",
            remedy="name results of machines of one type, calibrated with the same parameters",
        )

    types = [(one.mechanism.description or {}).get("type") for one in (first, other)]
    if types[0] != types[1]:
        raise refuse(f"their types are {types[0]!r} and {types[1]!r}")
    if first.names != other.names:
        apart = set(first.names) ^ set(other.names)
        raise refuse(f"only one has the parameters {listed(sorted(apart))}")
    for i, name in enumerate(first.names):
        units = [one.mechanism.parameters[name].unit for one in (first, other)]
        if units[0] != units[1]:
            raise refuse(f"the units of {name!r} differ")
        a, b = float(first.values[i]), float(other.values[i])
        if first.fixed[i] and other.fixed[i] and abs(a - b) > _SAME * max(1.0, abs(a)):
            raise refuse(f"{name!r} is fixed at {a:g} and at {b:g}")


def _check_apart(before: Sequence[MeasuredMachine], other: MeasuredMachine) -> None:
    """Raise InputError for readings that count already: they would make machines alike."""
    for one in before:
        same = np.array_equal(one.values, other.values) and not one.fixed.all()
        if same or (other.data is not None and one.data == other.data):
            raise InputError(
                f"the results {one.name!r} and {other.name!r} have the same readings",
                code="duplicate-name",
                remedy="name one result of each machine",
            )


def _reason(machines: Sequence[MeasuredMachine], i: int) -> str | None:
    """Why a parameter does not count; None where it does."""
    if all(one.fixed[i] for one in machines):
        return "fixed"
    fixed = [one.name for one in machines if one.fixed[i]]
    if fixed:
        return f"fixed in {listed(fixed, 3)}"
    loose = [one.name for one in machines if not one.determined[i] or one.covariance[i, i] <= 0.0]
    return f"not determined in {listed(loose, 3)}" if loose else None


def _together(machines: Sequence[MeasuredMachine]) -> Array:
    """(R, n) values, angles within half a turn of those of the first machine."""
    Y = np.array([one.values for one in machines])
    first = machines[0]
    turn = [2.0 * np.pi * (first.mechanism.parameters[n].unit == "rad") for n in first.names]
    turns = np.round((Y - Y[0]) / np.where(np.array(turn) > 0.0, turn, np.inf))
    return np.asarray(Y - turns * turn)


def _without(spread: Spread, r: int) -> Spread:
    """Of the machines other than r."""
    others = np.arange(len(spread.values)) != r
    return Spread(spread.values[others], spread.variances[others])


def _judged(
    machines: Sequence[MeasuredMachine],
    names: Sequence[str],
    Y: Array,
    V: Array,
    others: Sequence[Sequence[Spread]],
) -> tuple[FleetMachine, ...]:
    """Y, V: (R, n) values and variances; others: of the machines without one, by parameter."""
    R, n = Y.shape
    deviations = [
        [
            Deviation(name, y - rest.mean, v**0.5, rest.tail(y, v))
            for name, y, v, rest in zip(names, Y[r].tolist(), V[r].tolist(), others[r], strict=True)
        ]
        for r in range(R)
    ]
    # Bonferroni over the parameters of a machine, then Holm over the machines.
    least = np.array(
        [
            min(1.0, n * min(d.p_value for d in deviations_of_one))
            for deviations_of_one in deviations
        ]
    )
    order = np.argsort(least)
    times = np.empty(R)
    times[order] = R - np.arange(R)
    adjusted = np.empty(R)
    adjusted[order] = np.minimum(np.maximum.accumulate((least * times)[order]), 1.0)
    judged = []
    for one, deviations_of_one, p, k in zip(
        machines, deviations, adjusted.tolist(), times, strict=True
    ):
        beyond = [
            d.parameter
            for d in deviations_of_one
            if p < 1.0 - LEVEL and k * n * d.p_value < 1.0 - LEVEL
        ]
        judged.append(FleetMachine(one.name, one.poses, tuple(deviations_of_one), p, tuple(beyond)))
    return tuple(judged)


def _poses(
    C: Array, poses: NDArray[np.intp], prior: Array, fewest: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(n,) the least numbers of poses for the sds reached, without the prior and with it."""
    reached = np.sqrt(np.einsum("rii->ri", C).mean(axis=0))
    scale = reached[:, None] * reached
    # Scaled by the sds reached, all parameters weigh alike and the inverse keeps its digits.
    L = sum(np.linalg.inv(c / scale) / k for c, k in zip(C, poses.tolist(), strict=True)) / len(C)
    # Variances in units of those reached; the margin is rounding.
    wanted = 1.0 + 1e-9
    alone = np.maximum(np.ceil(np.diag(np.linalg.inv(L)) / wanted), fewest).astype(np.intp)
    prior_information = np.diag(np.square(reached / prior))
    needed, enough = alone, np.ones(len(prior), dtype=bool)
    for k in range(int(alone.max()), fewest - 1, -1):
        enough = enough & (np.diag(np.linalg.inv(k * L + prior_information)) <= wanted)
        needed = np.where(enough, np.minimum(needed, k), needed)
    return alone, needed
