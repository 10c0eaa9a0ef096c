"""What predictions need to know of a calibration, and how sure it is at its own poses."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.document.findings import (
    FurtherWavesEntry,
    PredictionEntry,
    PrintedEntry,
    SmoothErrors,
    UsualSd,
)
from loopcal.document.fit import NoiseCovarianceEntry, NoiseEntry
from loopcal.document.result_document import ResultDocument
from loopcal.errors import InputError
from loopcal.estimation.noise.learning import joint_covariances
from loopcal.estimation.prediction import predict_outputs
from loopcal.estimation.problem.constants import as_now
from loopcal.estimation.problem.patterns import Pattern
from loopcal.estimation.problem.problem import VALUES, Problem
from loopcal.estimation.products import rows_times
from loopcal.estimation.result import FitResult
from loopcal.estimation.sensitivity import output_sensitivity
from loopcal.estimation.solve.reduction import Spectrum
from loopcal.lazy import cached_property
from loopcal.mechanisms.instruments.camera import off_axis
from loopcal.mechanisms.mechanism import PIXELS, Mechanism
from loopcal.mechanisms.model_error import disturbances, with_model_error
from loopcal.mechanisms.outputs import OutputGroup, output_groups
from loopcal.mechanisms.structure.smooth import FurtherWaves, scaled, wave_errors
from loopcal.presentation.shown import brief, with_unit
from loopcal.small_samples import LearntCovariance
from loopcal.statistics.calibrated import (
    by_residuals,
    further_waves,
    rejected_by,
    residual_factor,
    residual_variance,
    stored_covariance,
    stored_pose_part,
    stored_waves,
)
from loopcal.statistics.other_conditions import MEASURE, unlike

# As `estimation.noise.prints` has it: central differences are right to nine digits.
_MOVED = 1e-5
"""By which points of a print are moved for derivatives [m]."""
# The 95 % point over 2000 poses is sure to half a per cent of them: sqrt(0.95 x 0.05 / 2000).
_MOST_POSES = 2000
# Chosen, not derived: far above rounding, far below an effect that counts.
_UNSEEN = 1e-6
"""An undetermined direction moves an output if more than this share of its single effects is
left when they are added up."""


@dataclass(frozen=True, eq=False)
class ReadingNoise:
    """What a calibration knows of the noise of single readings.

    sds: quantity -> sd of a reading [SI], empty where not known; learnt: whose sds the calibration
    has learnt; slopes: quantity -> relative changes of its variance along the slopes of the
    parameters' covariance, where these are known; joint: covariances [SI]
    of quantities that are not independent; unmeasured: quantities that no sensor reads, whatever
    columns hold start values of them.
    """

    sds: Mapping[str, float] = field(default_factory=dict)
    learnt: frozenset[str] = frozenset()
    slopes: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    joint: Mapping[tuple[str, ...], Array] = field(default_factory=dict)
    unmeasured: frozenset[str] = frozenset()

    @classmethod
    def of(
        cls,
        noise: Sequence[NoiseEntry],
        joint: Sequence[NoiseCovarianceEntry],
        unmeasured: Iterable[str],
    ) -> ReadingNoise:
        """From the entries of a document."""
        return cls(
            {q: entry.sd for entry in noise for q in entry.quantities},
            frozenset(q for e in noise if e.source == "estimated" for q in e.quantities),
            {q: entry.slopes for entry in noise for q in entry.quantities if entry.slopes},
            {entry.quantities: np.array(entry.matrix) for entry in joint},
            frozenset(unmeasured),
        )

    def scaled_by(self, factor: float) -> ReadingNoise:
        """With all variances multiplied by a number."""
        sds = {q: math.sqrt(factor) * sd for q, sd in self.sds.items()}
        return replace(self, sds=sds, joint={q: factor * m for q, m in self.joint.items()})


@dataclass(frozen=True, eq=False)
class Predictor:
    """What predictions need to know of a calibration.

    mechanism: with the calibrated values; names (n,) and covariance (n, n) [SI] of the estimated
    parameters, over the directions that are determined; undetermined: (n, d) steps [SI] that
    neither data nor prior limit; readings: what is known of their noise; usual: by instrument, the
    sd that parameters alone cause; typical: quantity -> a reading [SI] to start the search for
    outputs from; factor: by which the variances are larger here than the result states them, for
    its residuals are; conditions: known column (temperature, load) -> its range [SI] in the
    calibration; shared: output -> what errors that all outputs of an image share do to it
    (`PredictionEntry`); pose_part: (n, n) what `covariance` lacks where a pose is far from those of
    the fit, and smooth_errors, which say how far (of the result, without `factor`); seen: camera ->
    the largest angle [rad] from its axis at which a corner was read; printed: what the points of
    prints leave open; further_waves: errors of the machine that its discrepancy has no waves for.
    """

    __repr__ = brief

    mechanism: Mechanism
    names: tuple[str, ...]
    covariance: LearntCovariance
    undetermined: Array
    readings: ReadingNoise = field(default_factory=ReadingNoise)
    usual: tuple[UsualSd, ...] = ()
    typical: Mapping[str, float] = field(default_factory=dict)
    factor: float = 1.0
    conditions: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    shared: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    pose_part: Array | None = None
    smooth_errors: SmoothErrors | None = None
    seen: Mapping[str, float] = field(default_factory=dict)
    printed: PrintedEntry | None = None
    further_waves: tuple[FurtherWaves, ...] = ()

    @cached_property
    def units(self) -> dict[str, str]:
        """Output -> SI unit."""
        return {q: self.mechanism.quantities[q] for q in self.mechanism.outputs}

    @property
    def entry(self) -> PredictionEntry:
        """As a document holds it; the covariance only where the result's is not the same."""
        loose = self.undetermined.shape[1] > 0
        return PredictionEntry(
            largest_by_unit(self.usual),
            dict(self.typical),
            tuple(map(tuple, (self.covariance.matrix / self.factor).tolist())) if loose else None,
            tuple(map(tuple, self.undetermined.T.tolist())),
            self.usual,
            tuple(sorted(self.readings.unmeasured)),
            conditions=self.conditions,
            shared=self.shared,
            smooth_errors=self.smooth_errors,
            seen=self.seen,
            printed=self.printed,
            further_waves=tuple(
                FurtherWavesEntry(one.smooth.body, one.sd, tuple(map(tuple, one.moved.tolist())))
                for one in scaled(self.further_waves, 1.0 / self.factor)
            ),
        )

    def unlike(self, columns: Mapping[str, Array]) -> list[str]:
        """A sentence for each known column (N,) [SI] that leaves the range of the calibration."""
        units = self.mechanism.pose_constants
        return [f"{one} {MEASURE}" for one in unlike(self.conditions, units, columns)]


def largest_by_unit(usual: Sequence[UsualSd]) -> dict[str, float]:
    """SI unit -> the largest sd of any instrument."""
    largest: dict[str, float] = {}
    for one in usual:
        largest[one.unit] = max(one.sd, largest.get(one.unit, 0.0))
    return largest


def usual_words(usual: Sequence[UsualSd]) -> list[str]:
    """The sd that the parameters cause, a phrase per instrument and unit."""
    several = len({one.instrument for one in usual}) > 1
    return [
        f"the parameters cause an sd of up to {with_unit(one.sd, one.unit)}"
        + (f" as {one.instrument} sees it" if several else "")
        for one in usual
    ]


def predictor_of(document: ResultDocument, mechanism: Mechanism) -> Predictor:
    """The predictor from a document and the mechanism it is of.

    Raises InputError where the document lacks what predictions need.
    """
    stored, names = document.prediction, document.covariance.names
    if stored is None:
        raise without_outputs(mechanism)
    rejected = rejected_by(document.chi_squared, document.variance_factor_applied)
    covariance = stored_covariance(document.covariance, stored.covariance)
    pose_part = stored_pose_part(document.covariance)
    covariance = covariance.less(pose_part)
    readings = ReadingNoise.of(document.noise, document.noise_covariances, stored.unmeasured)
    if any(q in readings.sds and q not in mechanism.quantities for q in disturbances(mechanism)):
        mechanism = with_model_error(mechanism)
    usual = stored.by or tuple(
        UsualSd(group.instrument, group.station, group.unit, stored.sd_at_poses[group.unit])
        for group in output_groups(mechanism)
        if group.unit in stored.sd_at_poses
    )
    steps = np.array(stored.undetermined, dtype=float).reshape(-1, len(names)).T
    return Predictor(
        mechanism.with_nominal({p.name: p.value for p in document.parameters}),
        names,
        by_residuals(covariance, rejected),
        steps,
        readings.scaled_by(residual_factor(rejected)),
        usual,
        stored.typical,
        factor=residual_factor(rejected),
        conditions=stored.conditions,
        shared=stored.shared,
        pose_part=pose_part,
        smooth_errors=stored.smooth_errors,
        seen=stored.seen,
        printed=stored.printed,
        further_waves=scaled(stored_waves(stored, mechanism), residual_factor(rejected)),
    )


def without_outputs(mechanism: Mechanism) -> InputError:
    """What to raise where predictions are asked of a machine that has no outputs."""
    return InputError(
        f"{mechanism.name!r} has no outputs to predict: no instrument measures it",
        code="no-outputs",
        remedy="add the instrument whose readings are to be predicted, and calibrate again",
    )


def predictor(result: FitResult) -> Predictor | None:
    """What predictions need of a calibration; None for a mechanism without outputs."""
    if not result.mechanism.outputs:
        return None
    problem = result.problem
    corrections = np.array([result.corrections[q] for q in problem.mechanism.tape.quantities])
    names = problem.mechanism.tape.quantities
    everywhere = [frozenset(pattern.unmeasured) for pattern in problem.patterns]
    unmeasured = [names[i] for i in frozenset.intersection(*everywhere)] if everywhere else []
    joint = () if result.fit.solver.exact else joint_covariances(problem)
    x = problem.readings + corrections
    rejected = rejected_by(result.chi_squared, result.variance_factor_applied)
    factor = residual_factor(rejected)
    made = predictor_at(
        problem,
        result.calibrated,
        by_residuals(result.learnt_covariance.less(result.pose_part), rejected),
        result.spectrum,
        x,
        ReadingNoise.of(result.noise, joint, unmeasured).scaled_by(factor),
        further_waves=scaled(further_waves(result), factor),
        printed=result.printed,
    )
    groups = {(group.instrument, group.unit): group for group in output_groups(result.mechanism)}
    usual = tuple(
        replace(one, residual=_residual_sd(result, groups[one.instrument, one.unit].outputs))
        for one in made.usual
    )
    residual = residual_variance(result) if result.image_errors else None
    shared = {} if residual is None else residual.shared
    return replace(
        made,
        usual=usual,
        factor=factor,
        conditions=result.conditions,
        shared=shared,
        pose_part=result.pose_part,
        smooth_errors=result.smooth_errors,
        seen=_seen(problem, made.mechanism, x),
    )


def angles(mechanism: Mechanism, x: Array, constants: Array) -> dict[str, Array]:
    """Camera -> (N, points) angle [rad] from its axis to each point of its board, at readings x
    (k, N) and constants (c, N)."""
    readings = dict(zip(mechanism.tape.quantities, np.nan_to_num(x), strict=True))
    readings |= dict(zip(mechanism.pose_constants, constants, strict=True))
    each = {
        family.name: off_axis(mechanism, family, readings, x.shape[1])
        for family in mechanism.families
        if family.form == PIXELS
    }
    return {name: angle for name, angle in each.items() if angle is not None}


def _seen(problem: Problem, mechanism: Mechanism, x: Array) -> dict[str, float]:
    """Camera -> the largest angle at which a corner was read."""
    names, sd = mechanism.tape.quantities, problem.uncertainty.sd
    constants = as_now(mechanism, problem.pose_constants)
    families, seen = {family.name: family for family in mechanism.families}, {}
    for name, angle in angles(mechanism, x, constants).items():
        rows = [names.index(q) for q in families[name].readings[::2]]
        read = np.isfinite(np.broadcast_to(sd, x.shape)[rows]) & np.isfinite(problem.readings[rows])
        if read.any():
            seen[name] = float(angle[read.T].max())
    return seen


def _residual_sd(result: FitResult, outputs: Sequence[str]) -> float | None:
    """Of one of these outputs [SI], by the residuals; None where sds of readings say it."""
    if result.noise or result.freedom <= 0:
        return None
    if result.image_errors is not None:
        return result.image_errors.sd
    square = np.square([result.differences_after[q] for q in outputs])
    square = square[np.isfinite(square)]
    if not square.size:
        return None
    # The parameters take up what the equations exceed the degrees of freedom by.
    return math.sqrt(float(square.mean()) * result.solution.equations / result.freedom)


def predictor_at(
    problem: Problem,
    mechanism: Mechanism,
    covariance: LearntCovariance,
    system: Spectrum,
    x: Array,
    readings: ReadingNoise,
    *,
    further_waves: tuple[FurtherWaves, ...] = (),
    printed: PrintedEntry | None = None,
) -> Predictor:
    """The predictor of a parameter system, its usual sds taken at poses x (k, N) [SI]."""
    quantities = mechanism.tape.quantities
    typical = dict(zip(quantities, np.median(x, axis=1).tolist(), strict=True))
    bare = Predictor(
        mechanism,
        problem.names,
        covariance,
        system.scale[:, None] * system.directions[:, ~system.kept],
        readings,
        typical={q: v for q, v in typical.items() if math.isfinite(v)},
        printed=printed,
        further_waves=further_waves,
    )
    return replace(bare, usual=_usual(bare, problem, x))


def _usual(bare: Predictor, problem: Problem, x: Array) -> tuple[UsualSd, ...]:
    """By instrument, the sd that parameters cause, not exceeded at 95 % of some 2000 poses."""
    mechanism = bare.mechanism
    values = np.array([p.nominal for p in mechanism.parameters])
    outputs = {mechanism.tape.quantities.index(q) for q in mechanism.outputs}
    now = as_now(mechanism, problem.pose_constants)
    loops, unused = mechanism.predicting().tape.loops, mechanism.predicting().unused
    groups, gathered = output_groups(mechanism), []
    size = max(1, VALUES // max(len(outputs), 1) ** 2)  # covariances of images are large
    for pattern in problem.patterns:
        poses = _some(pattern, len(problem.poses))
        too = {i for i in pattern.unmeasured if mechanism.tape.quantities[i] not in unused}
        solved = outputs | too
        if not poses.size or len(solved) > len(loops):
            continue  # the other readings do not say where the outputs are
        at, constants = x[:, poses], now[:, poses]
        # An output without a reading has no value to linearise at.
        if outputs & set(pattern.absent):
            at = at.copy()
            at[sorted(outputs)] = predict_outputs(mechanism, values, at, constants)
        for begin in range(0, len(poses), size):
            part = np.s_[:, begin : begin + size]
            S = output_sensitivity(
                mechanism, values, bare.names, at[part], constants[part], pattern.unmeasured
            )
            moved = with_followers(bare, mechanism, S.by_parameter, at[part], constants[part])
            covariance = by_parameters(bare, moved.slopes) + moved.beside
            gathered.append([trace_sd(covariance, group) for group in groups])
    if not gathered:
        return ()
    usual = []
    for i, group in enumerate(groups):
        sizes = np.concatenate([one[i] for one in gathered])
        sizes = sizes[np.isfinite(sizes)]
        if sizes.size:
            # Not the largest, which one pose at the edge decides.
            sd = float(np.percentile(sizes, 95))
            usual.append(UsualSd(group.instrument, group.station, group.unit, sd))
    return tuple(usual)


def _some(pattern: Pattern, total: int) -> NDArray[np.intp]:
    """The poses of a pattern, thinned."""
    chosen = np.arange(0, total, max(1, -(-total // _MOST_POSES)))
    return np.intersect1d(chosen, np.arange(total)[pattern.poses])


def by_parameters(calibrated: Predictor, S: Array) -> Array:
    """C_p = S Cov S^T, (N, o, o); inf for outputs that an undetermined direction moves."""
    matrix = calibrated.covariance.matrix
    if not np.isfinite(matrix).all():  # without a pose to spare nothing is known of their errors
        return np.full((*S.shape[:2], S.shape[1]), np.inf)
    covariance: Array = rows_times(S, matrix) @ S.transpose(0, 2, 1)
    for step in calibrated.undetermined.T:
        effect = np.abs(S @ step)
        # measured by the largest single effect in the pose: an output may feel none of them
        single = (np.abs(S) * np.abs(step)).max(axis=(1, 2))
        pose, output = np.nonzero(effect > _UNSEEN * single[:, None])
        covariance[pose, output, output] = np.inf
    return covariance


class WithFollowers(NamedTuple):
    """slopes: (N, o, n) by the parameters and the offsets that follow them; beside: (N, o, o)
    what offsets and waves change of the covariance besides."""

    slopes: Array
    beside: Array


def with_followers(
    calibrated: Predictor, mechanism: Mechanism, S: Array, x: Array, constants: Array
) -> WithFollowers:
    """What moves outputs at readings x (k, N) [SI] as the parameters err; S: (N, o, n) by these."""
    readings = dict(zip(mechanism.tape.quantities, x, strict=True))
    readings |= dict(zip(mechanism.pose_constants, constants, strict=True))
    slopes, beside = _with_prints(calibrated, mechanism, S, x, constants)
    return WithFollowers(slopes, beside + by_further_waves(calibrated, S, slopes, readings))


def by_further_waves(
    calibrated: Predictor, S: Array, slopes: Array, readings: Mapping[str, Array]
) -> Array:
    """(N, o, o) what waves that the discrepancy leaves out change of C_p.

    S: (N, o, n) by the parameters alone; slopes: and by what follows them. The fit takes up waves
    of amplitudes b as errors F b of the parameters, which C_p holds. Between the poses S F b is
    nearly Z b, what the waves do themselves; far away it is not. The error is (Z - S F) b in place
    of S F b.
    """
    waves = calibrated.further_waves
    return wave_errors(waves, S, slopes, readings, calibrated.names).changed


def _with_prints(
    calibrated: Predictor, mechanism: Mechanism, S: Array, x: Array, constants: Array
) -> tuple[Array, Array]:
    """Slopes and covariance by offsets of points of prints at readings x (k, N) [SI].

    An output depends on one point alone, so that all points move at once: with its derivatives g
    (3,) by the offset of its point it gains g^T F in S and errs by g^T (U w + V v) besides.
    """
    printed = calibrated.printed
    if printed is None:
        return S, np.zeros((len(S), 1, 1))
    place = {p.name: i for i, p in enumerate(mechanism.parameters)}
    values = np.array([p.nominal for p in mechanism.parameters])
    number = {name: i for i, name in enumerate(printed.names)}
    points = [":".join(q.split(":")[1:3]) for q in calibrated.units]
    errors = [np.array(part) for part in (printed.follow, printed.alone, printed.together)]
    follow, alone, together = errors[0], errors[1], errors[2].reshape(-1, len(number)).T
    slopes = S.copy()
    by_point = np.zeros((len(S), len(points), 3))
    by_all = np.zeros((len(S), len(points), together.shape[1]))
    for axis in "xyz":
        names = [f"{point.replace(':', '_')}_{axis}" for point in points]
        rows = [i for i, name in enumerate(names) if name in number]
        ends = []
        for way in (_MOVED, -_MOVED):
            moved = values.copy()
            moved[list({place[names[i]] for i in rows})] += way
            ends.append(predict_outputs(mechanism, moved, x, constants, calibrated.names))
        g = ((ends[0] - ends[1])[rows] / (2.0 * _MOVED)).T[:, :, None]
        which = [number[names[i]] for i in rows]
        slopes[:, rows] += g * follow[which]
        by_point[:, rows] += g * alone[which]
        by_all[:, rows] += g * together[which]
    beside = by_point @ by_point.transpose(0, 2, 1) * np.equal.outer(points, points)
    return slopes, beside + by_all @ by_all.transpose(0, 2, 1)


def trace_sd(covariance: Array, group: OutputGroup) -> Array:
    """(N,) root of the trace over the outputs of a group [its unit], of an image by point."""
    variance = np.einsum("noo->no", covariance)[:, list(group.rows)].sum(axis=1)
    variance = variance / group.points
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))  # rounding leaves less than none
