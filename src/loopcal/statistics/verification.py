"""Is it still the machine that was calibrated, and how accurate is it there?

On another day the instrument stands elsewhere. Its placement is found anew (`replacing`), and so
is what was mounted anew; the machine's parameters are held. The innovation (`innovation`) then
says whether the new poses differ from the calibration by more than the covariances of both
explain. The accuracy of the held machine stands beside that of the machine as drawn, placed with
the same freedom, and beside the one that the stated covariance leads one to expect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.document.accuracy import Distances
from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.estimation.accuracy import accuracy, by_pose, deviations, main_unit
from loopcal.estimation.noise.learning import with_model
from loopcal.estimation.prediction import output_differences
from loopcal.estimation.problem.constants import with_latest
from loopcal.estimation.problem.problem import Problem, build_problem
from loopcal.estimation.result import Result
from loopcal.estimation.sensitivity import output_sensitivity
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import MODEL, Noise, NoiseLike
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.change_tests import what_changed
from loopcal.statistics.gain import Gain
from loopcal.statistics.innovation import (
    Linearised,
    components_of,
)
from loopcal.statistics.replacing import Freedom, Replaced, replaced
from loopcal.statistics.tolerance import Quantile
from loopcal.statistics.verified import Placed, Verification, WorstPose

Array = NDArray[np.float64]
# Chosen, not derived: time against the scatter of what is drawn.
_DRAWS = 200
"""Of the errors that the stated covariance leads one to expect."""
# Chosen, not derived: what a reader looks at.
_WORST = 5


def verify(
    calibration: Result | Calibrated,
    data: Dataset | Result | Any,
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
    calibrated = Calibrated.of(calibration, "") if isinstance(calibration, Result) else calibration
    calibrated = calibrated.stationed
    data = data.dataset if isinstance(data, Result) else data
    data = data if isinstance(data, Dataset) else Dataset.from_arrays(data)
    check_tolerance(tolerance)
    with one_blas_thread():
        freedom = Freedom.of(calibrated.mechanism, remounted)
        problem = day_problem(calibrated, data, Noise.of(noise))
        return _verified(calibrated, problem, freedom, tolerance)


def check_tolerance(tolerance: float | None) -> None:
    """Raise InputError for a tolerance that is no distance above zero."""
    if tolerance is not None and not tolerance > 0.0:
        raise InputError(
            f"the tolerance is {tolerance:g}",
            code="invalid-value",
            remedy="give a distance above zero",
        )


def day_problem(calibrated: Calibrated, data: Dataset, noise: Noise | None) -> Problem:
    """The poses of another day at the calibrated parameters, all of which count as estimated.

    noise: of these readings, else that of the calibration.
    """
    mechanism = calibrated.mechanism
    data = with_latest(mechanism, data if noise else as_learnt(calibrated, data))
    weighed = None if calibrated.residual is not None else (noise or noise_of(calibrated))
    if weighed is not None:
        mechanism, data = with_model(mechanism, data, weighed)
    # Nothing is estimated by it: with informative priors any number of poses will do.
    free = mechanism.parameters.with_prior({"*": 1.0}).with_fixed(["*"], fixed=False)
    return build_problem(mechanism.with_parameters(free), data, weighed)


def as_learnt(calibrated: Calibrated, data: Dataset) -> Dataset:
    """The readings without sds of their own where the calibration has learnt better ones."""
    learnt = {
        q for entry in calibrated.noise if entry.source == "estimated" for q in entry.quantities
    }
    return replace(data, sds={q: sd for q, sd in data.sds.items() if q not in learnt})


def noise_of(calibrated: Calibrated) -> Noise:
    """The sds that a calibration used, for other readings; what had none was not measured."""
    entries: dict[str | tuple[str, ...], Any] = {}
    for entry in calibrated.noise:
        if entry.role == "disturbance":
            entries[MODEL] = entry.sd
            continue
        entries |= dict.fromkeys(entry.quantities, entry.sd)
    disturbances = calibrated.mechanism.disturbances
    unmeasured = [q for q in calibrated.mechanism.quantities if q not in (*entries, *disturbances)]
    return Noise(entries | dict.fromkeys(unmeasured, np.inf))


@dataclass(frozen=True, eq=False)
class _Day:
    """The poses of another day, at a machine that is held.

    problem: at the calibrated parameters; variance: of every loop equation, where the readings are
    taken as exact; components: quantities of each learnt sd.
    """

    calibrated: Calibrated
    problem: Problem
    freedom: Freedom
    variance: float | None
    components: Sequence[Sequence[int]]

    @classmethod
    def of(cls, calibrated: Calibrated, problem: Problem, freedom: Freedom) -> _Day:
        variance = None if calibrated.residual is None else calibrated.residual.value
        components = components_of(calibrated, problem.mechanism.tape.quantities)
        return cls(calibrated, problem, freedom, variance, components)

    def placed(self, problem: Problem) -> Replaced:
        """These poses with the instrument placed anew."""
        return replaced(problem, self.freedom, variance=self.variance, components=self.components)

    def changed(self, parameters: Mapping[str, float], zeros: Mapping[str, float]) -> Replaced:
        """Placed with changes of parameters and of the zeros of readings, by name [SI]."""
        problem, names = self.problem, self.problem.mechanism.parameters.names
        values = dict(zip(names, problem.start.tolist(), strict=True))
        readings = problem.readings.copy()
        for name, change in zeros.items():
            readings[problem.mechanism.tape.quantities.index(name)] += change
        for name, change in parameters.items():
            values[name] += change
        return self.placed(_with_values(replace(problem, readings=readings), values))

    def linearised(self, placement: Replaced) -> Linearised:
        """The equations of the held machine there."""
        return Linearised.of(placement, self.calibrated)

    def as_drawn(self) -> tuple[Replaced | None, str | None]:
        """The machine as drawn, placed with the same freedom; or why it cannot be."""
        names = self.problem.mechanism.parameters.names
        drawn = dict(zip(names, self.calibrated.nominal.tolist(), strict=True))
        try:
            return replace(self, components=()).placed(_with_values(self.problem, drawn)), None
        except (InputError, NoTrustworthyResult) as error:
            return None, error.message


def _with_values(problem: Problem, values: Mapping[str, float]) -> Problem:
    mechanism = problem.mechanism.with_nominal(dict(values))
    return replace(problem, start=np.array([*values.values()]), mechanism=mechanism)


def _verified(
    calibrated: Calibrated, problem: Problem, freedom: Freedom, tolerance: float | None
) -> Verification:
    mechanism, day = problem.mechanism, _Day.of(calibrated, problem, freedom)
    placement = day.placed(problem)
    linear = day.linearised(placement)
    nominal, unplaced = day.as_drawn()
    measured = problem.readings[[mechanism.tape.quantities.index(q) for q in mechanism.compared]]
    differences = _differences(placement)
    drawn = np.full_like(differences, np.nan) if nominal is None else _differences(nominal)
    apart = deviations(mechanism, measured, differences)
    distances = by_pose(apart)
    others = by_pose(deviations(mechanism, measured, drawn))
    gain = None
    if nominal is not None and distances is not None and others is not None:
        gain = Gain.in_rms(np.square(distances), np.square(others))
    beyond = calibrated.carried or calibrated.rejected is not None
    changes = what_changed(placement, linear, day.changed, day.linearised, beyond)
    return Verification(
        poses=problem.poses,
        unit=main_unit(apart) or "m",
        calibrated=_distances(mechanism, measured, differences),
        nominal=None if nominal is None else _distances(mechanism, measured, drawn),
        expected=_expected(placement, linear, day.variance, measured),
        gain=gain,
        innovation=linear.innovation() if changes is None else changes.test,
        changes=changes,
        placed=_placed(placement, linear, freedom),
        worst=_worst(problem, distances, linear.by_pose(placement).squares),
        quantile=None if distances is None else Quantile.of(distances),
        tolerance=tolerance,
        unplaced=unplaced,
    )


def _differences(placement: Replaced) -> Array:
    return output_differences(placement.problem, placement.parameters, placement.corrections)


def _distances(mechanism: Mechanism, measured: Array, differences: Array) -> Distances | None:
    output_accuracy = accuracy(deviations(mechanism, measured, differences))
    return None if output_accuracy is None else output_accuracy.distances


def _worst(problem: Problem, distances: Array | None, squares: Array) -> tuple[WorstPose, ...]:
    size = squares if distances is None else distances
    order = np.argsort(-np.where(np.isfinite(size), size, -np.inf))[:_WORST]
    return tuple(
        WorstPose(
            problem.poses[i],
            None if distances is None or not np.isfinite(distances[i]) else float(distances[i]),
            float(squares[i]),
        )
        for i in order.tolist()
        if np.isfinite(size[i]) and np.isfinite(squares[i])
    )


def _placed(placement: Replaced, linear: Linearised, freedom: Freedom) -> tuple[Placed, ...]:
    """What was found anew, with sds that include what is not known of the machine."""
    mechanism, g = placement.problem.mechanism, placement.directions.shape[1]
    response = placement.directions @ linear.solve[:g]
    follows = response @ linear.A - linear.root
    variance = np.square(response).sum(axis=1) + np.square(follows).sum(axis=1)
    # solve F is 1 along what these poses determine, and less where the pseudoinverse leaves a gap.
    seen = np.abs(placement.directions @ (linear.solve @ linear.F)[:g, :g])
    order, entries = mechanism.parameters.names, []
    for name in freedom.names:
        i = order.index(name)
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
    placement: Replaced, linear: Linearised, variance: float | None, measured: Array
) -> Distances | None:
    """The distances that the stated covariance leads one to expect, as means over random draws.

    What is placed anew follows the error of the held machine as far as it can, and takes up some
    of the noise.
    """
    problem, mechanism = placement.problem, placement.problem.mechanism
    if not mechanism.outputs:
        return None
    names = mechanism.tape.quantities
    outputs = [names.index(q) for q in mechanism.outputs]
    differences = _differences(placement)[: len(outputs)]
    x = problem.readings + placement.corrections
    # Linearised at the computed outputs, where the loops close.
    x[outputs] += np.nan_to_num(differences)
    unread = np.flatnonzero(np.isinf(problem.uncertainty.sd).all(axis=1)).tolist()
    parameters = placement.parameters, mechanism.parameters.names
    S = output_sensitivity(mechanism, *parameters, x, problem.pose_constants, unread)
    g = placement.directions.shape[1]
    follows = placement.directions @ (linear.solve @ linear.A)[:g]
    machine = S.by_parameter @ (follows - linear.root)
    noise = _reading_noise(problem, S.by_reading, outputs, variance)
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
        one = _distances(mechanism, measured, drawn)
        if one is not None:
            samples.append((one.mean, one.rms, one.p95, one.max))
    if not samples:
        return None
    mean, _, p95, largest = np.mean(samples, axis=0).tolist()
    # Squares are averaged, for the mean of roots is smaller than the root of the mean.
    rms = float(np.sqrt(np.square(np.array(samples)[:, 1]).mean()))
    return Distances(mean, rms, p95, largest, int(np.isfinite(differences).all(axis=0).sum()))


def _reading_noise(
    problem: Problem, by_reading: Array, outputs: Sequence[int], variance: float | None
) -> Array:
    """(N, o, k) a square root of the covariance that the readings of these poses cause."""
    T = np.nan_to_num(by_reading)
    # Computed minus measured: an error of the measured output enters with the other sign.
    T[:, range(len(outputs)), list(outputs)] = -1.0
    if variance is not None:
        sd = np.zeros(T.shape[2])
        sd[list(outputs)] = np.sqrt(variance)
        return np.asarray(T * sd)
    sd = np.where(np.isinf(problem.uncertainty.sd), 0.0, problem.uncertainty.sd)
    G: Array = T * np.broadcast_to(sd, problem.readings.shape).T[:, None, :]
    for block in problem.uncertainty.blocks:
        G[:, :, block.indices] = T[:, :, block.indices] @ block.factor
    return G
