"""The parts of a document, from the values of a result."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.document.choice import TermEntry
from loopcal.document.findings import Identifiability, Undetermined
from loopcal.document.fit import CovarianceEntry, NoiseEntry, ParameterEntry
from loopcal.document.plain import finite, lower
from loopcal.document.result_document import CoarseReadings, DataEntry, JoinedFile
from loopcal.estimation.problem.pose_equations import PoseEquations
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.redundancy import UNCONTROLLED, Redundancy
from loopcal.estimation.solve.reduction import spectrum, undetermined
from loopcal.estimation.solve.solution import Solution
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.datasheet import rounding_sd
from loopcal.measurements.resolution import recorded_step
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter
from loopcal.small_samples import LearntCovariance

# Sums in another order differ by some 1e-12: chosen, not derived, between that and any widening.
_ALIKE = 1e-9
# docs/decisions/0065.
_COARSE = 0.5
"""Steps whose rounding alone is this share of an sd are not small against it."""


def parameter_entry(
    parameter: Parameter, value: float, sd: float | None, degrees_of_freedom: float | None
) -> ParameterEntry:
    """One parameter; sd: None where fixed, infinite where not identifiable."""
    return ParameterEntry(
        parameter.name,
        parameter.unit,
        parameter.nominal,
        value,
        finite(sd),
        finite(parameter.prior_sd),
        parameter.fixed,
        None if sd is None else math.isfinite(sd),
        None,
        role=parameter.role,
        owner=parameter.owner,
        meaning=parameter.meaning,
        degrees_of_freedom=finite(degrees_of_freedom),
        same=parameter.same,
    )


def covariance_entry(
    names: tuple[str, ...],
    covariance: LearntCovariance,
    unwidened: Array,
    loose: frozenset[str],
) -> CovarianceEntry:
    """The covariance of these parameters; unwidened: that by which the fit weighed its prior;
    loose: those that nothing determines."""
    open_ = np.array([name in loose for name in names], dtype=bool)
    lost = open_[:, None] | open_ | ~np.isfinite(covariance.matrix)
    rows = zip(covariance.matrix.tolist(), lost.tolist(), strict=True)
    matrix = tuple(
        tuple(None if gone else value for value, gone in zip(*row, strict=True)) for row in rows
    )
    lower_unwidened, plain = None, covariance.plain if len(covariance.slopes) else covariance.matrix
    if not np.allclose(unwidened, plain, rtol=_ALIKE, atol=0.0, equal_nan=True):
        lower_unwidened = lower(unwidened)
    if not len(covariance.slopes):
        return CovarianceEntry(names, "SI", matrix, unwidened=lower_unwidened)
    slopes = tuple(map(lower, covariance.slopes))
    return CovarianceEntry(
        names, "SI", matrix, lower(covariance.plain), slopes, unwidened=lower_unwidened
    )


def shares(corrections: Mapping[str, Array], sds: Mapping[str, Array]) -> dict[str, float]:
    """What the corrections (N,) of each quantity contribute to chi-squared; they add up to 1."""
    squares = {}
    for quantity, values in corrections.items():
        weighed = np.isfinite(sds[quantity]) & (sds[quantity] > 0.0)
        squares[quantity] = float(np.square(values[weighed] / sds[quantity][weighed]).sum())
    total = sum(squares.values()) or 1.0
    return {quantity: square / total for quantity, square in squares.items()}


def noise_entries(
    noise: Sequence[NoiseEntry],
    shares: Mapping[str, float],
    quantities: Sequence[str],
    checked: Redundancy | None,
) -> tuple[NoiseEntry, ...]:
    """The sds with the share of each in chi-squared, and what tests it; quantities: of its rows."""
    entries = []
    for entry in noise:
        entry = replace(entry, share=min(sum(shares.get(q, 0.0) for q in entry.quantities), 1.0))
        if checked is not None:
            rows = [quantities.index(q) for q in entry.quantities]
            number = max(float(np.nansum(checked.numbers[rows])), 0.0)
            square = max(float(np.nansum(checked.squares[rows])), 0.0)
            tested = number > UNCONTROLLED * np.isfinite(checked.numbers[rows]).sum()
            factor = square / number if tested else None
            entry = replace(entry, redundancy=number, variance_factor=factor)
        entries.append(entry)
    return tuple(entries)


def absorbed(problem: Problem, terms: Sequence[TermEntry]) -> float:
    """Degrees of freedom that priors may use although the parameters are nearer to the drawing."""
    informed = int(np.isfinite(problem.prior_sd).sum()) - sum(term.columns for term in terms)
    return max(informed, 0) + sum(term.spared for term in terms)


def coarse_readings(
    data: Dataset,
    noise: Sequence[NoiseEntry],
    problem: Problem,
    equations: Sequence[PoseEquations],
) -> tuple[CoarseReadings, ...]:
    """Quantities whose rounding makes a quarter or more of the variance of their readings.

    equations: of every pose where the fit ended. Corrections smaller than the rounding (by two sds
    of a learnt sd, by half of a stated one) show that the column holds targets on a grid. They do
    not where an error of the model took their place, as large as the rounding would make it.
    """
    coarse: dict[tuple[str, float], list[str]] = {}
    instead: dict[tuple[str, float], list[str]] = {}
    modelled = any(entry.role == "disturbance" and entry.sd > 0.0 for entry in noise)
    for entry in noise:
        shown = entry.sd * math.sqrt(
            1.0 if entry.variance_factor is None else entry.variance_factor
        )
        for quantity in entry.quantities:
            if entry.role != "reading" or quantity not in data.readings:
                continue
            step = recorded_step(data, quantity, entry.unit)
            sd = rounding_sd(step)
            unsure = math.inf if entry.sd_of_sd is None else entry.sd_of_sd
            least = max(_COARSE * sd, sd - 2.0 * unsure)
            if shown >= least and sd > 0.0 and sd >= _COARSE * entry.sd:
                coarse.setdefault((entry.unit, step), []).append(quantity)
            elif sd > _COARSE * entry.sd and (modelled or not entry.sd):
                instead.setdefault((entry.unit, step), []).append(quantity)
    caused = _caused(problem, equations) if instead else {}
    share = sum(
        rounding_sd(step) ** 2 * caused[q] for (_, step), names in instead.items() for q in names
    )
    if _COARSE**2 <= share <= 1.0 / _COARSE**2:
        for key, names in instead.items():
            coarse.setdefault(key, []).extend(names)
    return tuple(
        CoarseReadings(tuple(names), unit, step, rounding_sd(step))
        for (unit, step), names in coarse.items()
    )


def _caused(problem: Problem, equations: Sequence[PoseEquations]) -> Mapping[str, float]:
    """What a unit of variance of each reading causes in the equations, in mean squares of these."""
    caused, square = np.zeros(len(problem.readings)), 0.0
    for block in equations:
        caused += block.squares.sum(axis=0)
        square += float(np.square(block.E).sum())
    names = problem.mechanism.tape.quantities
    return dict(zip(names, (caused / max(square, 1e-300)).tolist(), strict=True))


def data_entry(dataset: Dataset, used: int, quantities: Sequence[str]) -> DataEntry:
    """Which readings were used, of these quantities."""
    source = dataset.source
    return DataEntry(
        source.file,
        source.sha256,
        source.rows_read or len(dataset),
        used,
        tuple(source.excluded),
        source.every,
        tuple(q for q in quantities if q in dataset.readings),
        tuple(JoinedFile(part.file, part.sha256) for part in source.joined),
        source.copied,
        source.discarded,
        agreeing=source.agreeing,
        averaged=source.averaged,
        measured=source.measured,
    )


def inputs_entry(dataset: Dataset, mechanism: Mechanism) -> dict[str, Any]:
    """How the readings of this mechanism came in, as a project states it; empty where all are SI
    under their own names.

    Later readings are then read alike. What has no readings is unmeasured.
    """
    names = (*mechanism.quantities, *mechanism.pose_constants)
    aside = {*dataset.readings, *mechanism.implied, *mechanism.disturbances}
    unread = [q for q in mechanism.quantities if q not in aside]
    if not dataset.source.entry and not unread:
        return {}

    def of_mechanism(entry: Mapping[str, Any]) -> dict[str, Any]:
        columns = {q: c for q, c in entry.get("columns", {}).items() if q in names}
        return {"file": "", **entry, "columns": columns}

    data = of_mechanism(dataset.source.entry)
    if "join" in data:
        data["join"] = [of_mechanism(part) for part in data["join"]]
    noise = {q: {"sd": "inf"} for q in unread}
    return {"data": data, "noise": noise} if noise else {"data": data}


# What the poses of a fit determine: its rank, and the directions in which nothing does.


def identifiability(problem: Problem, solution: Solution) -> Identifiability:
    """At a solution, by its parameter system with and without the prior."""
    system = alone = solution.spectrum
    count = len(problem.free)
    if np.isfinite(problem.prior_sd).any():
        # Rank and directions do not depend on the offset, so zeros will do.
        alone = spectrum(solution.data, np.zeros(count), np.full(count, np.inf))
    return Identifiability(
        system.rank,
        count,
        alone.rank,
        finite(system.condition) if system.rank == count else None,
        tuple(Undetermined.of(c) for c in undetermined(system, problem.names)),
    )
