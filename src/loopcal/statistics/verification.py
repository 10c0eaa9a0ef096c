"""Is it still the machine that was calibrated, and how accurate is it there?

On another day the instrument stands elsewhere. Its placement is found anew (`replacing`), and so
is what was mounted anew; the machine's parameters are held. The innovation (`innovation`) then
says whether the new poses differ from the calibration by more than the covariances of both
explain. The accuracy of the held machine stands beside that of the machine as drawn, placed with
the same freedom, and beside the one that the stated covariance leads one to expect.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.document.accuracy import Distances
from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.estimation.accuracy import (
    Apart,
    by_pose,
    deviations,
    main_distances,
    main_unit,
    overall,
)
from loopcal.estimation.dependence.dependence import joint_rows
from loopcal.estimation.dependence.stated_poses import StatedPoses
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.result import FitResult
from loopcal.estimation.sensitivity import output_sensitivity
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.measurements.copies import copies
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, NoiseLike
from loopcal.mechanisms.structure.smooth import wave_errors
from loopcal.statistics.another_day import Day
from loopcal.statistics.calibrated import Calibrated, ResidualVariance
from loopcal.statistics.change_tests import Explained, what_changed
from loopcal.statistics.changed import DRIFT_OR_CHANGE, LEVEL, WhatChanged
from loopcal.statistics.day_drift import drifted, smallest_drift
from loopcal.statistics.day_noise import DayNoise
from loopcal.statistics.day_run import NO_POSES, Run, faults, searched, with_further
from loopcal.statistics.gain import Gain
from loopcal.statistics.innovation import Linearised, noise_freedoms
from loopcal.statistics.joint_errors import JointErrors
from loopcal.statistics.later_corners import fitting_corners
from loopcal.statistics.other_conditions import rounded, unlike
from loopcal.statistics.shared_repeats import day_as_means
from loopcal.statistics.verdict import Quantile
from loopcal.statistics.verified import Placed, Verification, WorstPose

# Chosen, not derived: time against the scatter of what is drawn.
_DRAWS = 200
"""Of the errors that the stated covariance leads one to expect."""
# Chosen, not derived: what a model lacks elsewhere is seldom so much larger, and is smooth.
_SCATTERS = 3.0
"""An error over what is stated that is sought as scatter, though a spread was learnt."""
# Chosen, not derived: what a reader looks at.
_WORST = 5
_ROUNDED, _TURNED = 1e-6, 1e-5
"""Share of a span by which the same reading may differ between two files, and of joints: a program
repeats its joints, and the noise of what the instruments read tells its runs."""


def verify(
    calibration: FitResult | Calibrated,
    data: Dataset | FitResult | Any,
    *,
    noise: NoiseLike | None = None,
    remounted: bool | Sequence[str] = False,
    tolerance: float | None = None,
) -> Verification:
    """Check a calibrated machine against readings of another day.

    data: readings [SI] as `calibrate` takes them, or the result of another calibration, whose
    readings are taken; noise: sds of these readings, else the calibration's. Every instrument is
    placed anew. remounted: True where all that instruments look at was mounted anew, or the names
    of instruments, targets or parameters (globs); these are estimated too. tolerance: distance
    [SI] that 95 % of poses shall keep.

    Raises InputError where readings or sds are missing, and for a name that is not there.
    """
    calibrated = (
        Calibrated.of(calibration, "") if isinstance(calibration, FitResult) else calibration
    )
    data = data.dataset if isinstance(data, FitResult) else data
    data = data if isinstance(data, Dataset) else Dataset.from_arrays(data)
    check_tolerance(tolerance)
    calibrated, stated = calibrated.loadable.stationed, Noise.of(noise)
    data = fitting_corners(calibrated, data, stated, remounted)
    return verified(calibrated, data, stated, remounted, tolerance)


def verified(
    calibrated: Calibrated,
    data: Dataset,
    stated: Noise | None,
    remounted: bool | Sequence[str] = False,
    tolerance: float | None = None,
) -> Verification:
    """`verify` of readings without wrong corners."""
    calibrated = calibrated.predicting(data).stationed
    mechanism = calibrated.mechanism
    copied = copies(data, mechanism.recorded, mechanism.outputs).copied
    if copied.size:
        kept = np.delete(np.arange(len(data)), copied)
        data, stated = data.without_copies(copied), stated and stated.take(kept)
    with one_blas_thread():
        repeated = _repeated(calibrated, data)
        data, stated = day_as_means(calibrated, data, stated, remounted)
        day = Day.of(calibrated, data, stated, remounted)
        made = _verified(day, tolerance, len(copied), repeated)
        if not made.shifts.found:
            means, noise = day_as_means(calibrated, data, stated, remounted, apart=True)
            if len(means) < len(data):
                data, day = means, Day.of(calibrated, means, noise, remounted)
                made = _verified(day, tolerance, len(copied), repeated)
    passed = made.verdict["consistent"].passed
    coarse = "" if passed else rounded(calibrated, data)
    return replace(made, read_as=" ".join(filter(None, [data.source.read_as, coarse])))


def _repeated(calibrated: Calibrated, data: Dataset) -> int:
    """How many poses have the readings of a pose of the calibration, however they were rounded.

    Equal poses are neighbours along any direction, so only those near along one are compared.
    """
    earlier = calibrated.poses
    if earlier is None:
        return 0
    mechanism = calibrated.mechanism
    read = [q for q in mechanism.quantities if q in data.readings and q in earlier.readings]
    # Readings of one unit share a span: a joint that hardly moved is rounded like the others.
    spans, groups = dict[tuple[str, bool], float](), dict[str, tuple[str, bool]]()
    for q in read:
        before = earlier.readings[q]
        if np.isfinite(before).any():
            groups[q] = mechanism.quantities[q], q in mechanism.joints
            span = float(np.nanmax(before) - np.nanmin(before))
            spans[groups[q]] = max(spans.get(groups[q], 0.0), span)
    varied = []
    for q, group in groups.items():
        if 0.0 < spans[group] < np.inf:
            within = (_TURNED if group[1] else _ROUNDED) * spans[group]
            varied.append((earlier.readings[q] / within, data.readings[q] / within))
    if not varied:
        return 0
    # A missing reading equals a missing one, and no other.
    before, now = (np.nan_to_num(np.array(rows).T, nan=1e12) for rows in zip(*varied, strict=True))
    # Seeded; a random direction keeps the poses of a grid apart.
    direction = np.random.default_rng(0).uniform(0.5, 1.0, before.shape[1])
    along = before @ direction
    order = np.argsort(along)
    before, along = before[order], along[order]
    first = np.searchsorted(along, now @ direction - direction.sum())
    last = np.searchsorted(along, now @ direction + direction.sum(), side="right")
    same = np.zeros(len(now), dtype=bool)
    for step in range(int((last - first).max(initial=0))):
        near = np.flatnonzero((first + step < last) & ~same)
        same[near] = (np.abs(before[first[near] + step] - now[near]) <= 1.0).all(axis=1)
    return int(same.sum())


def check_tolerance(tolerance: float | None) -> None:
    """Raise InputError for a tolerance that is no distance above zero."""
    if tolerance is not None and not tolerance > 0.0:
        raise InputError(
            f"the tolerance is {tolerance:g}",
            code="invalid-value",
            remedy="give a distance above zero",
        )


def _verified(day: Day, tolerance: float | None, copied: int, repeated: int) -> Verification:
    linear, problem = day.linearised(), day.problem
    day = day.near(linear.placement)
    columns = faults(day, linear)
    changes, run = (None, Run()) if columns else _searched(day, linear)
    # Poses that do not fit the others say nothing of the machine, but a tolerance counts them.
    rest, judged = day, linear
    if run.outliers:
        rest = day.without(np.array(run.outliers, dtype=np.intp))
        judged = rest.linearised()
    placement, mechanism = judged.placement, problem.mechanism
    apart = deviations(mechanism, placement.measured, placement.differences)
    distances, nominal, gain, unplaced = by_pose(apart), None, None, None
    every = _sizes(linear)
    try:
        drawn = rest.as_drawn().placed()
    except (InputError, NoTrustworthyResult) as error:
        unplaced = error.message
    else:
        apart_as_drawn = deviations(mechanism, drawn.measured, drawn.differences)
        nominal, others = _distances(apart_as_drawn), by_pose(apart_as_drawn)
        if distances is not None and others is not None:
            gain = Gain.in_rms(np.square(distances), np.square(others))
    calibrated, (expected, chance) = _distances(apart), _expected(judged, day.calibrated.residual)
    rare = 1.0 if calibrated is None else chance(calibrated.rms)
    if changes is not None and (drift := smallest_drift(rest, judged, changes.spread)):
        changes = replace(changes, candidates=(*changes.candidates, drift))
    # Expected errors are the stated ones; what is placed anew is as unsure as readings scatter.
    scatter = changes.scatter if changes is not None else {}
    noise = DayNoise(scatter.get("joints", 1.0), scatter.get("readings", 1.0))
    at_scatter = rest.noisier(noise).linearised() if scatter else judged
    known = dict(zip(mechanism.tape.pose_constants, problem.pose_constants, strict=True))
    outliers = tuple(problem.poses[i] for i in run.outliers)
    worst = (*(one for one in _worst(linear) if one.pose in outliers), *_worst(judged))
    return Verification(
        poses=problem.poses,
        unit=main_unit(apart) or "m",
        calibrated=calibrated,
        nominal=nominal,
        expected=expected,
        gain=gain,
        innovation=linear.innovation() if changes is None else changes.test,
        changes=changes,
        placed=_placed(at_scatter, day.freed),
        worst=worst[:_WORST],
        quantile=None if every is None else Quantile.of(every),
        tolerance=tolerance,
        unplaced=unplaced,
        faults=columns,
        shifts=run.shifts,
        outliers=outliers,
        rare=rare,
        copied=copied,
        repeated=repeated,
        sound=day.calibrated.sound,
        flange=StatedPoses.of(problem) is not None,
        unlike=tuple(unlike(day.calibrated.conditions, mechanism.pose_constants, known)),
    )


def _fewer(what: WhatChanged, before: WhatChanged) -> bool:
    """Whether nothing changed, or some of what changed before and nothing else."""
    names = {one.name for one in what.found}
    return what.verdict == "unchanged" or (
        bool(names) and names <= {one.name for one in before.found}
    )


def _searched(day: Day, linear: Linearised) -> tuple[WhatChanged | None, Run]:
    """What changed since the calibration, and during the run; or by how much readings scatter.

    Readings that scatter more than stated look like changes, or like none where most equations of
    an image see no joint. What changed is searched anew with such sds then. It counts where it is
    no more.
    """
    explained, run = _changes(day, linear)
    if explained is None:
        return None, run
    what = explained.what
    explains = what.verdict == "unchanged" or (what.left or 0.0) >= LEVEL
    lacking = explains and 1.0 < what.spread <= _SCATTERS**2
    if lacking or day.calibrated.residual is not None:
        return what, run
    # Beside all that may have changed: on another machine of the type nothing scatters.
    names, rows = day.problem.mechanism.tape.quantities, joint_rows(day.problem)
    learnt = noise_freedoms(day.calibrated, [names[i] for i in rows])
    noise = DayNoise.of(explained.linear, explained.every, learnt)
    if not (scatter := noise.larger):
        return what, run
    noisier = day.noisier(noise)
    again, later = _changes(noisier, noisier.linearised())
    if again is None or (again.what.left or 0.0) < LEVEL:
        return what, run
    before, after = (
        (*one.found, *at.shifts.found, *at.outliers)
        for one, at in ((what, run), (again.what, later))
    )
    if len(after) > len(before):
        return what, run
    return replace(again.what, test=what.test, scatter=scatter), later


def _changes(day: Day, linear: Linearised) -> tuple[Explained | None, Run]:
    """What changed since the calibration, and during the run.

    What happens during a run looks like changes before it, and these like a step at its begin: the
    run is searched beside the changes, for steps and then for drifts, and then the changes beside
    what it shows. Where changes do not explain the poses, what moved alone may. Poses that do not
    fit the others look like both, so all of it is searched again without them. Where the joints
    tell the order of the poses, a drift of the instrument may explain the changes, and anywhere
    errors of joints that poses share.
    """
    whole, every, outliers = day, day.problem, NO_POSES
    explained = what_changed(day, linear)
    if explained is None:
        return None, Run()
    what = explained.what
    if [one.kind for one in what.found] == ["delay"] and (what.left or 0.0) < LEVEL:
        return explained, Run()  # what it leaves looks like moves and outliers, and is none
    if what.found and (what.left or 0.0) < LEVEL and (alone := _moved_alone(day, linear)):
        return alone
    run = searched(explained.linear, explained.columns)
    while run.outliers and (more := with_further(every, outliers, run.outliers)) is not None:
        rest = whole.without(more)
        if (beside := what_changed(rest, rest.linearised())) is None:
            break
        day, outliers, explained = rest, more, beside
        run = searched(explained.linear, explained.columns)
    if run.shifts.found:
        day = replace(day, moved=run.shifts.found)
        explained = what_changed(day, day.linearised()) or explained
    if not run.shifts.found and run.shifts.tested and (drift := drifted(day, explained)):
        shifts, day, explained = drift
        run = replace(run, shifts=shifts)
    elif not run.shifts.found and explained.what.found and (drifting := day.drifting):
        beside = what_changed(drifting, drifting.linearised())
        if beside is not None and beside.what.verdict == "unchanged":
            what = replace(explained.what, verdict=DRIFT_OR_CHANGE)
            return replace(explained, what=what), run.among(every, outliers)
    if explained.what.verdict != "unchanged":
        joints = JointErrors.of(explained.linear, explained.columns)
        day = replace(day, joints=joints)
        beside = None if joints is None else what_changed(day, day.linearised())
        if beside is not None and _fewer(beside.what, explained.what):
            explained = beside
    return explained, run.among(every, outliers)


def _moved_alone(day: Day, linear: Linearised) -> tuple[Explained, Run] | None:
    """What moved during the run, where nothing else is needed to explain the poses."""
    run = searched(linear, np.zeros((len(linear.e), 0)))
    clear = run.shifts.told_apart
    if run.outliers or not clear or len(clear) < len(run.shifts.found):
        return None
    day = replace(day, moved=run.shifts.found)
    explained = what_changed(day, day.linearised())
    if explained is None or explained.what.verdict != "unchanged":
        return None
    return explained, run


def _distances(apart: Sequence[Apart]) -> Distances | None:
    output_accuracy = overall(apart)
    return None if output_accuracy is None else output_accuracy.distances


def _sizes(linear: Linearised) -> Array | None:
    """(N,) the distance of each pose [unit]; None without outputs."""
    placement = linear.placement
    mechanism = placement.problem.mechanism
    return by_pose(deviations(mechanism, placement.measured, placement.differences))


def _worst(linear: Linearised) -> list[WorstPose]:
    """The poses, the farthest first."""
    poses, distances = linear.placement.problem.poses, _sizes(linear)
    squares = linear.by_pose().squares
    size = squares if distances is None else distances
    order = np.argsort(-np.where(np.isfinite(size), size, -np.inf))
    return [
        WorstPose(
            poses[i],
            None if distances is None or not np.isfinite(distances[i]) else float(distances[i]),
            float(squares[i]),
        )
        for i in order.tolist()
        if np.isfinite(size[i]) and np.isfinite(squares[i])
    ]


def _placed(linear: Linearised, names: Sequence[str]) -> tuple[Placed, ...]:
    """What was found anew, with sds that include what is not known of the machine."""
    placement = linear.placement
    mechanism, g = placement.problem.mechanism, placement.directions.shape[1]
    response = placement.directions @ linear.solve[:g]
    follows = response @ linear.A - linear.root
    variance = np.square(response).sum(axis=1) + np.square(follows).sum(axis=1)
    # solve F is 1 along what these poses determine, and less where the pseudoinverse leaves a gap.
    seen = np.abs(placement.directions @ (linear.solve @ linear.F)[:g, :g])
    order, entries = mechanism.parameters.names, []
    for name in names:
        i = order.index(name)
        if not placement.J[:, i].any():
            continue  # of an instrument that saw nothing, as of another arm
        shown = abs(seen[i] - np.abs(placement.directions[i])).max(initial=0.0) < 1e-6
        entries.append(
            Placed(
                name,
                float(placement.parameters[i]),
                float(np.sqrt(variance[i])) if shown else None,
                mechanism.parameters[name].unit,
            )
        )
    return tuple(entries)


def _expected(
    linear: Linearised, residual: ResidualVariance | None
) -> tuple[Distances | None, Callable[[float], float]]:
    """The distances that the stated covariance leads one to expect, as means over random draws, and
    the share of draws whose rms is at least so large.

    What is placed anew follows the error of the held machine as far as it can, and takes up some
    of the noise.
    """
    placement = linear.placement
    problem, mechanism = placement.problem, placement.problem.mechanism
    if not mechanism.outputs:
        return None, lambda rms: 1.0
    names = mechanism.tape.quantities
    outputs = [names.index(q) for q in mechanism.outputs]
    measured, differences = placement.measured, placement.differences[: len(outputs)]
    x = problem.readings + placement.corrections
    # Linearised at the computed outputs, where the loops close.
    x[outputs] += np.nan_to_num(differences)
    unread = np.flatnonzero(np.isinf(problem.uncertainty.sd).all(axis=1)).tolist()
    parameters = placement.parameters, mechanism.parameters.names
    S = output_sensitivity(mechanism, *parameters, x, problem.pose_constants, unread)
    g = placement.directions.shape[1]
    follows = placement.directions @ (linear.solve @ linear.A)[:g]
    machine = S.by_parameter @ (follows - linear.root)
    readings, slopes = dict(zip(names, x, strict=True)), S.by_parameter
    waves, order = linear.further_waves, mechanism.parameters.names
    errors = wave_errors(waves, slopes, slopes, readings, order)
    machine[:, :, : errors.left.shape[2]] -= errors.left + errors.taken
    noise = _reading_noise(problem, S.by_reading, outputs, residual)
    # The placement takes up as many equations as it has rank, and their share of the noise.
    left = (len(linear.e) - linear.rank) / max(len(linear.e), 1)
    noise = noise * np.sqrt(max(left, 0.0) * linear.factor)
    # Seeded, so that the same readings get the same answer.
    draw = np.random.default_rng(0)
    samples = []
    for _ in range(_DRAWS):
        h, v = draw.standard_normal(machine.shape[2]), draw.standard_normal(noise.shape[::2])
        errors = machine @ h + np.einsum("nok,nk->no", noise, v)
        drawn = np.full(measured.shape, np.nan)
        drawn[: len(outputs)] = np.where(np.isfinite(differences), errors.T, np.nan)
        drawn[len(outputs) :] = 0.0
        one = main_distances(deviations(mechanism, measured, drawn))
        if one is not None:
            samples.append(one.ravel())
    # Summed up together: 200 calls of a percentile cost more than the draws.
    every = np.array(samples).reshape(len(samples), -1)
    every = every[:, np.isfinite(every).all(axis=0)]
    if not every.size:
        return None, lambda rms: 1.0
    drawn_rms = np.sqrt(np.square(every).mean(axis=1))
    mean, largest = float(every.mean()), float(every.max(axis=1).mean())
    p95 = float(np.percentile(every, 95, axis=1).mean())
    # Squares are averaged, for the mean of roots is smaller than the root of the mean.
    rms, count = float(np.sqrt(np.square(drawn_rms).mean())), np.isfinite(differences).all(axis=0)
    expected = Distances(mean, rms, p95, largest, int(count.sum()))
    # A draw of R equations has the relative variance 2 / R of chi-squared, the noise that is left
    # 2 / (R - rank). A factor chi-squared(w) / w adds the rest: 2 / (R - rank) = 2 / R + 2 / w, to
    # first order. Exact for noise alone is a beta((R - rank) / 2, rank / 2) of it.
    R = len(linear.e)
    w = R * (R - linear.rank) / max(linear.rank, 1)
    tail = drawn_rms * np.sqrt(draw.chisquare(w, len(drawn_rms)) / w) if w > 0.0 else drawn_rms
    return expected, lambda other: float((tail >= other).mean())


def _reading_noise(
    problem: Problem,
    by_reading: Array,
    outputs: Sequence[int],
    residual: ResidualVariance | None,
) -> Array:
    """(N, o, k) a square root of the covariance that the readings of these poses cause."""
    T = np.nan_to_num(by_reading)
    # Computed minus measured: an error of the measured output enters with the other sign.
    T[:, range(len(outputs)), list(outputs)] = -1.0
    if residual is not None:
        names = [problem.mechanism.tape.quantities[i] for i in outputs]
        return np.asarray(T[:, :, list(outputs)] @ residual.root(names))
    return problem.uncertainty.through(T)
