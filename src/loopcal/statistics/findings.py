"""What a calibration's own equations tell beyond the parameters: collected for file and summary.

How far a change along the run moves the end point: its size beside its significance.

In long runs a change of a tenth of the noise is significant. Whether it matters is another
question: by how much it moves what the machine is calibrated for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NoReturn

import numpy as np

from loopcal.document.accuracy import Distances
from loopcal.document.change_points import NOT_SEARCHED, ChangePoint, ChangePoints, Shifts
from loopcal.document.findings import (
    ConflictEntry,
    Observability,
    OtherOptimum,
    RegionEntry,
    RepeatsEntry,
)
from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.estimation.accuracy import accuracy
from loopcal.estimation.prediction import output_differences
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.execution.executor import gathered
from loopcal.execution.forked import process_cores
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.station import standing
from loopcal.mechanisms.structure.structured import EFFECT
from loopcal.presentation.shown import brief
from loopcal.statistics.case import Case, nominal_case
from loopcal.statistics.change_points import apart, find_shifts
from loopcal.statistics.changes import shift_lines
from loopcal.statistics.conflicts import conflicts
from loopcal.statistics.folds import may_repeat
from loopcal.statistics.identifiability import (
    WhatDataSay,
    calibration_index,
    data_spectrum,
    observability,
    what_data_say,
)
from loopcal.statistics.noise_floor import noise_floor
from loopcal.statistics.optima import other_optima
from loopcal.statistics.outliers import Outliers, find_columns, find_poses, of_file
from loopcal.statistics.predictor import Predictor, predictor, usual_words
from loopcal.statistics.region import Span, region_of
from loopcal.statistics.reliability import ReadingReliability, reliability
from loopcal.statistics.scatter import Scatter, scatter


@dataclass(frozen=True, eq=False)
class Findings:
    """identifiability: data beside prior; observability: of the poses; predictor: or None;
    outliers: what does not fit; shifts: what moved along the run, toml: the lines that model it;
    optima: others that fit about as well; region: where the machine works, and the sd there;
    nominal: accuracy of the nominal machine, placed and mounted; noise_floor: what the noise of the
    readings alone causes; reliability: what single readings can hide; scatter: the
    covariance that the poses themselves show; conflicts: each observation beside the others;
    repeats: of a pose, where a stated method takes the error that they share as independent.

    Poses that fit with the shifts modelled are not outliers.
    """

    __repr__ = brief

    identifiability: WhatDataSay
    observability: Observability
    predictor: Predictor | None
    outliers: Outliers
    shifts: Shifts
    toml: str
    optima: tuple[OtherOptimum, ...]
    region: RegionEntry | None = None
    nominal: Distances | None = None
    noise_floor: float | None = None
    reliability: ReadingReliability | None = None
    scatter: Scatter | None = None
    conflicts: tuple[ConflictEntry, ...] = ()
    repeats: RepeatsEntry | None = None

    def __iter__(self, *_: Any) -> NoReturn:
        raise TypeError(
            "these are analyses by name, as result.findings.outliers; the list with codes and "
            "words is result.document.findings"
        )

    __getitem__ = __iter__

    def words(self) -> str:
        """For the summary: one line each."""
        lines = [self.observability.words(), self.identifiability.index.words()]
        if self.predictor is not None:
            lines += [
                f"prediction: {words} at 95 % of these poses"
                for words in usual_words(self.predictor.usual)
            ]
        lines += self.identifiability.words() + self.outliers.lines()
        lines += [] if self.reliability is None else self.reliability.entry.lines()
        lines += self.shifts.lines()
        return "\n".join(lines + [str(optimum) for optimum in self.optima])


Search = Callable[[FitResult], Any]


def _repeats(result: FitResult) -> RepeatsEntry | None:
    """Of a stated method, where poses may repeat."""
    problem = result.problem
    sd = np.broadcast_to(problem.uncertainty.sd, problem.readings.shape)
    names = problem.mechanism.tape.quantities
    sds = dict(zip(names, np.median(sd, axis=1).tolist(), strict=True))
    if result.parts.chosen or result.all_poses is not None:
        return None
    if not may_repeat(problem.mechanism, result.dataset, sds):
        return None
    from loopcal.statistics.shared_repeats import shared_by_repeats  # where poses repeat

    return shared_by_repeats(result, Noise(sds))


def findings(
    result: FitResult, region: Mapping[str, Span] | None = None, beside: Search | None = None
) -> Findings:
    """Everything that follows from the result's parameter system.

    region: quantity -> range [SI] in which the machine works, where not its joints' limits; beside:
    what is computed of the result beside the searches, by this process.
    """
    solution = result.solution
    with one_blas_thread():
        prediction = predictor(result)
        searches: tuple[Search, ...] = (_shifts, find_columns, _poses)
        if beside is not None:
            searches = (beside, *searches)  # whoever asks does the first piece
        *_, shifts, columns, outliers = gathered(process_cores(), _searched, result, searches)
        if columns:  # a file that is at fault as a whole says nothing of single poses
            outliers, shifts = of_file(columns), NOT_SEARCHED
        parts = result.parts
        earlier = parts.change_points or ChangePoints((), shifts.level, 0)
        modelled = tuple(as_fitted(result, p, earlier.found) for p in earlier.found)
        new = tuple(sized(result, p) for p in shifts.found if apart(p, modelled))
        toml = earlier.toml + shift_lines(result.dataset, new)
        shifts = replace(shifts, found=tuple(sorted((*modelled, *new), key=lambda p: p.number)))
        remaining = tuple(o for o in outliers.found if o.pose not in shifts.explained)
        return Findings(
            what_data_say(
                result.problem,
                result.information,
                result.sd,
                calibration_index(result.problem, solution.poses, solution.equations),
                unit_sd=_unit_sd(result),
            ),
            observability(result.information, solution.poses),
            prediction,
            replace(outliers, found=(*parts.discarded, *remaining)),
            shifts,
            toml,
            () if result.all_poses is not None else other_optima(result),
            None if prediction is None else region_of(result, prediction, region),
            None if result.all_poses is not None or parts.chosen else nominal_distances(result),
            None if result.all_poses is not None else noise_floor(result),
            reliability(result),
            scatter(result),
            conflicts(result),
            _repeats(result),
        )


def _searched(result: FitResult, search: Search) -> Any:
    return search(result)


def _shifts(result: FitResult) -> Shifts:
    """What changed during the run, where no column is at fault."""
    if not result.status.converged or result.faults:
        return NOT_SEARCHED
    searched = result.parts.shifts
    return find_shifts(result) if searched is None else searched


def _poses(result: FitResult) -> Outliers:
    """Poses that are wrong; not sought where columns are, which make every pose look so."""
    return of_file(result.faults) if result.faults else find_poses(result)


def as_fitted(result: FitResult, point: ChangePoint, points: Sequence[ChangePoint]) -> ChangePoint:
    """A change that is modelled, by sizes and sds of the fit: a step against the poses before it.

    points: all that are modelled. Each segment of a shift counts from the start of the run.
    """
    if not point.modelled:
        return point
    steps = {p.number for p in points if p.shape == "step" and p.changing == point.changing}
    segment = sorted(steps | {point.number}).index(point.number)
    every, owners = result.mechanism.parameters, (point.effect, EFFECT)
    changes = dict(point.changes)
    for name, change in point.changes.items():
        of_name = [
            p.name
            for p in every
            if p.owner in owners and (p.changes == name or p.name == f"{name}_drift")
        ]
        # A drift is its first parameter; those of its bends follow.
        ends = of_name[:1] if point.shape == "ramp" else of_name[max(segment - 1, 0) : segment + 1]
        if not ends or not set(ends) <= set(result.estimated):
            continue
        rows = [result.estimated.index(end) for end in ends]
        signs = np.array([-1.0, 1.0])[-len(rows) :]
        if point.moved == "joint" and name in result.mechanism.quantities:
            signs = -signs  # The zero of an encoder falls by what its readings gain.
        variance = signs @ result.covariance[np.ix_(rows, rows)] @ signs
        size = sum(sign * result.value[end] for sign, end in zip(signs, ends, strict=True))
        changes[name] = replace(change, size=float(size), sd=math.sqrt(max(variance, 0.0)))
    return replace(point, changes=changes)


def _unit_sd(result: FitResult) -> float | None:
    """Sd of a whitened equation: 1 by the stated sds, else from the residuals."""
    freedom = result.solution.equations - data_spectrum(result.information).rank
    variance = result.fit.solver.unit_variance(result.information.chi_squared, freedom)
    return None if variance is None else math.sqrt(variance)


def nominal_distances(result: FitResult) -> Distances | None:
    """Accuracy of the nominal machine, placed and mounted, on the poses of a result."""
    if not result.mechanism.outputs:
        return None
    try:
        fit = replace(result.fit, prior=None)
        case = nominal_case(Case(result.mechanism, result.dataset, None, fit))
        # Faults of the file were sought by this drawing already.
        nominal_accuracy = replace(case, trusted=True).calibrated().accuracy_after
    except (InputError, NoTrustworthyResult):
        return None  # nothing can be placed, or not by these readings
    return None if nominal_accuracy is None else nominal_accuracy.distances


def sized(result: FitResult, point: ChangePoint) -> ChangePoint:
    """The change with `moves`, the rms distance over the poses by which the whole of it moves the
    outputs, computed or read; unknown without outputs, and of a stream.

    Less what noise alone adds to its square: a change of r parameters by chance has a gain of r.
    """
    names = result.mechanism.compared
    if not names or result.all_poses is not None:
        return point
    # A station that the machine has not stands at 0, behind the other parameters.
    mechanism = standing(result.mechanism, point.names)
    problem, at = replace(result.problem, mechanism=mechanism), result.solution
    parameters, read = mechanism.parameters.names, mechanism.tape.quantities
    values = np.pad(at.parameters, (0, len(parameters) - len(at.parameters)))
    readings = problem.readings.copy()
    for name, change in point.changes.items():
        if name in parameters:
            values[parameters.index(name)] += change.size
        elif name in read:
            readings[read.index(name)] += change.size
        elif point.moved == "expansion":
            lengths = [p.dimension == "length" for p in mechanism.parameters]
            values[lengths] *= 1.0 + change.size
    moved = output_differences(replace(problem, readings=readings), values, at.corrections)
    before = result.differences_after
    off = {q: row - before[q] for q, row in zip(names, moved, strict=True)}
    displacement = accuracy(result.deviations(off))
    if displacement is None:
        return point
    real = max(1.0 - len(point.changes) / point.gain, 0.0) if point.gain else 0.0
    return replace(point, moves=displacement.rms * math.sqrt(real), unit=displacement.unit)
