"""Where the calibrated machine is, how sure that is, and whether it was ever asked that before.

The end point y predicted from readings x with the parameters p has two independent uncertainties,

    C_p = S_p Cov(p) S_p^T   and   C_x = S_x Sigma S_x^T,   S = dy/dp, dy/dx  (`sensitivity`),

first order propagation of covariance (JCGM 102:2011, 6.2). C_p is the calibration's, and the same
however often a pose is repeated; C_x comes with each reading. Poses unlike those of the
calibration have a C_p that no residual there could show: that is what the alarm is for.

Least squares takes readings as exact, and its residuals hold the errors of all readings. Errors of
joints come anew with each pose, so C_x is then the residual variance, as large for every output of
an instrument. It is too large for the true end point by the noise of the instrument, which cannot
be separated. Where chi-squared rejects the stated sds, both parts are as large as the residuals.

The answer "valid" and what `verify` expects are the same C_p + C_x (`parts_at`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.document.plain import plain
from loopcal.errors import InputError
from loopcal.estimation.dependence.stated_poses import QUANTITIES, unknown_share
from loopcal.estimation.prediction import predict_outputs, solving
from loopcal.estimation.problem.constants import with_implied, with_latest
from loopcal.estimation.products import rows_times
from loopcal.estimation.result import FitResult
from loopcal.estimation.sensitivity import Sensitivity, output_sensitivity
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise, NoiseLike, resolve_noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.outputs import OutputGroup, output_groups
from loopcal.mechanisms.parallel.free_body import COLUMNS, POSITION
from loopcal.presentation.shown import brief, significant, with_unit
from loopcal.small_samples import LearntCovariance, f_limit, t_quantile
from loopcal.statistics.predictor import (
    Predictor,
    angles,
    by_parameters,
    predictor,
    trace_sd,
    with_followers,
)

# Record 0054: valid up to 3.
ALARM = 3.0
"""Extrapolation: the parameters' part of the sd is more than so many times that at 95 % of the
calibration poses."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Outputs of N poses with their covariance [SI], in the order of `outputs`.

    from_parameters, from_readings: (N, o, o), the latter None where the sds of the readings are
    not known; inf where an undetermined direction moves the outputs, NaN where no loop closes.
    ratio: (N,) the parameters' part of the sd over the usual at the calibration poses (the
    largest over instruments and units); NaN where that is not known. groups: outputs whose sds
    belong together: those of one unit that one instrument reads. freedom (N, o), denominator (N,):
    degrees of freedom of Student's t of each output, and of the denominator of F of all; inf where
    the sds are known and none was learnt from the calibration. by_residuals: whether the residuals
    of the fit stand for the noise of the readings; unlike: warnings of temperatures and loads
    outside the range of the calibration (`Predictor.unlike`), and of corners where no image shows
    the lens; outside: (N,) whether a pose has such corners.
    """

    __repr__ = brief

    poses: tuple[str, ...]
    outputs: Mapping[str, Array]
    units: Mapping[str, str]
    from_parameters: Array
    from_readings: Array | None
    ratio: Array
    groups: tuple[OutputGroup, ...]
    freedom: Array
    denominator: Array
    by_residuals: bool = False
    unlike: tuple[str, ...] = ()
    outside: NDArray[np.bool_] | None = None

    @property
    def covariance(self) -> Array:
        """(N, o, o) of both parts together; of the parameters alone where the other is unknown."""
        if self.from_readings is None:
            return self.from_parameters
        return self.from_parameters + self.from_readings

    @property
    def sd(self) -> dict[str, Array]:
        """Output -> (N,) sd [SI]."""
        sds = np.sqrt(np.maximum(np.einsum("noo->on", self.covariance), 0.0))  # rounding
        return dict(zip(self.outputs, sds, strict=True))

    def half_width(self, level: float = 0.95) -> dict[str, Array]:
        """Output -> (N,) half width [SI] of the interval that holds it at this level."""
        factor = np.array([[t_quantile(level, f) for f in row] for row in self.freedom.tolist()])
        factor = factor.reshape(self.freedom.shape).T
        return {q: k * sd for k, (q, sd) in zip(factor, self.sd.items(), strict=True)}

    def region(self, level: float = 0.95) -> Array:
        """(N,) the limit of d^T covariance^-1 d for the errors d of all outputs of a pose."""
        return f_limit(level, len(self.outputs), self.denominator)

    @property
    def extrapolated(self) -> NDArray[np.bool_]:
        """(N,) whether the parameters' part is far above that at the calibration poses, or a lens
        is asked for where no corner was."""
        return self.ratio > ALARM if self.outside is None else (self.ratio > ALARM) | self.outside

    def columns(self) -> dict[str, Array | tuple[str, ...]]:
        """As a table, one row per pose: outputs, their sds, sd by instrument, covariance, alarm.
        Of images the covariance of u and v of each corner alone."""
        table: dict[str, Array | tuple[str, ...]] = {"pose": self.poses}
        for name, values in self.outputs.items():
            table[f"{name} [{self.units[name]}]"] = values
        for name, sd in self.sd.items():
            table[f"{name} sd [{self.units[name]}]"] = _finite(sd)
        for name, half in self.half_width().items():
            table[f"{name} +- 95 % [{self.units[name]}]"] = _finite(half)
        parts = {"sd": self.covariance, "sd from parameters": self.from_parameters}
        if self.from_readings is not None:
            parts["sd from readings"] = self.from_readings
        for name, covariance in parts.items():
            for group, of in zip(self.groups, self._named(), strict=True):
                table[f"{name}{of} [{group.unit}]"] = _finite(trace_sd(covariance, group))
        names, whole = list(self.outputs), parts["sd"]
        corner = {row: (g, k // 2) for g in self.groups if g.image for k, row in enumerate(g.rows)}
        for i, a in enumerate(names):
            for j, b in enumerate(names[: i + 1]):
                if corner.get(i) == corner.get(j):
                    key = f"covariance {b} {a} [{self.units[b]} {self.units[a]}]"
                    table[key] = _finite(whole[:, j, i])
        table["region 95 %"] = self.region()
        table["extrapolated"] = tuple("yes" if e else "no" for e in self.extrapolated)
        return table

    def to_dataframe(self) -> Any:
        """`columns()` as a pandas DataFrame where pandas is installed, else one of polars."""
        try:
            import pandas
        except ImportError:
            import polars

            return polars.DataFrame(self.columns())
        return pandas.DataFrame(self.columns())

    def document(self) -> dict[str, Any]:
        """As one JSON document: SI, null for what is not known, and for covariances of images."""
        outputs, sds, whole = list(self.outputs.items()), self.sd, self.covariance
        image = any(group.image for group in self.groups)
        halves, limits = self.half_width(), self.region()
        by = [
            (group, trace_sd(whole, group), trace_sd(self.from_parameters, group))
            for group in self.groups
        ]
        poses = [
            {
                "pose": pose,
                "outputs": {q: float(v[i]) for q, v in outputs},
                "sd": {q: float(v[i]) for q, v in sds.items()},
                "half_width_95": {q: float(v[i]) for q, v in halves.items()},
                "region_95": float(limits[i]),
                "covariance": None if image else whole[i],
                "covariance_from_parameters": None if image else self.from_parameters[i],
                "by": [
                    {
                        "instrument": group.instrument,
                        "station": group.station,
                        "unit": group.unit,
                        "sd": float(sizes[i]),
                        "sd_from_parameters": float(parts[i]),
                    }
                    for group, sizes, parts in by
                ],
                "ratio": float(self.ratio[i]),
                "extrapolated": bool(self.extrapolated[i]),
            }
            for i, pose in enumerate(self.poses)
        ]
        document: dict[str, Any] = plain(
            {
                "units": dict(self.units),
                "readings_included": self.from_readings is not None,
                "alarm_ratio": ALARM,
                "extrapolated": int(self.extrapolated.sum()),
                "words": self.words(),
                "poses": poses,
            }
        )
        return document

    def words(self) -> str:
        """What was predicted, how sure it is, and the alarm."""
        finite = np.isfinite(np.array(list(self.outputs.values())))
        predicted = int(finite.any(axis=0).sum())
        lost = (
            "" if predicted == len(self.poses) else ": the others lack a reading, or do not close"
        )
        lines = [f"{predicted} of {len(self.poses)} poses predicted{lost}"]
        further = "what the fit leaves" if self.by_residuals else "readings"
        parts = [("parameters", self.from_parameters), (further, self.from_readings)]
        for name, covariance in parts:
            if covariance is None:
                lines.append("sd caused by readings: unknown, because their sds are unknown")
                continue
            for group, of in zip(self.groups, self._named(), strict=True):
                of_it = finite[list(group.rows)].any(axis=0)  # of another arm nothing was read
                if of_it.any():
                    spread = _spread(covariance[of_it], group)
                    lines.append(f"sd{of} caused by {name}: {spread}")
        return "\n".join([*lines, *self._alarm(), *self.unlike])

    def _named(self) -> list[str]:
        """What tells the groups of several instruments apart."""
        several = len({group.instrument for group in self.groups}) > 1
        return [f" of {group.instrument}" if several else "" for group in self.groups]

    def _alarm(self) -> list[str]:
        beyond = self.ratio > ALARM
        if not beyond.any():
            return []
        finite = self.ratio[beyond & np.isfinite(self.ratio)]
        times = f" (up to {significant(float(finite.max()), 2)} times)" if finite.size else ""
        return [
            f"EXTRAPOLATION  in {int(beyond.sum())} of {len(self.poses)} poses the calibration "
            f"is far less certain than at its own poses{times}: its stated accuracy does not "
            f"apply there. Calibrate again with poses like these among the measured ones."
        ]


def _finite(values: Array) -> Array:
    return np.where(np.isfinite(values), values, np.nan)


def _spread(covariance: Array, group: OutputGroup) -> str:
    sizes = trace_sd(covariance, group)
    sizes = sizes[~np.isnan(sizes)]
    if not sizes.size:
        return "unknown"
    middle, most = (with_unit(float(v), group.unit) for v in (np.median(sizes), sizes.max()))
    return f"median {middle}, largest {most}"


def predict(
    calibration: FitResult | Predictor, data: Dataset | Any, *, noise: NoiseLike | None = None
) -> Prediction:
    """Where the calibrated machine is at these readings, with covariance and extrapolation alarm.

    data: readings (N,) [SI] of the other quantities, as a Dataset, a dict or a DataFrame; readings
    of outputs serve as start of the search only. noise: sds of these readings, else the
    calibration's. Covariances are C_p + C_x of the module, by first order propagation (JCGM
    102:2011). Raises InputError for a mechanism without outputs, and where readings are missing
    that the loops cannot make up for.
    """
    calibrated = calibration if isinstance(calibration, Predictor) else predictor(calibration)
    if calibrated is None:
        raise InputError(
            "the mechanism has no outputs to predict",
            code="no-outputs",
            remedy="name the quantities that its loops predict: outputs = (...)",
        )
    stated_noise = Noise.of(noise)
    data = data if isinstance(data, Dataset) else Dataset.from_arrays(data)
    machine = calibrated.mechanism.predicting()
    data = with_latest(machine, data)
    read = {q for family in calibrated.mechanism.families for q in family.readings}
    moving = {q: v for q, v in machine.implied.items() if q not in read}
    data = with_implied(replace(machine, implied=moving, orientations=()), data)
    guessed = _guessed(calibrated, data, stated_noise)
    hidden = {q for q in machine.tape.quantities if q not in data.readings or q in guessed}
    aside = (*machine.disturbances, *machine.outputs, *machine.unused)
    _check_enough(machine, [q for q in machine.tape.quantities if q in hidden.difference(aside)])
    at = parts_at(calibrated, data, hidden, noise=stated_noise)
    total = calibrated.covariance.through(at.slopes)
    if at.from_readings is not None:
        total = total.plus(at.from_readings)
    outside, words = _outside(calibrated, at.angles)
    smooth = calibrated.smooth_errors
    if at.elsewhere is not None and smooth is not None:
        total = total.widened(at.elsewhere, smooth.spread)
    return Prediction(
        data.poses,
        dict(zip(calibrated.units, at.outputs, strict=True)),
        calibrated.units,
        at.from_parameters,
        None if at.from_readings is None else at.from_readings.matrix,
        _ratio(at.from_parameters, calibrated),
        output_groups(calibrated.mechanism),
        total.freedom,
        total.denominator,
        at.by_residuals,
        (*calibrated.unlike(data.readings), *words),
        outside,
    )


@dataclass(frozen=True, eq=False)
class Parts:
    """Outputs of N poses (o, N) [SI], how the parameters move them (N, o, n), and both parts of
    their covariance (N, o, o); from_readings None where sds are not known; by_residuals: of what
    the fit leaves; elsewhere: the share of `from_parameters` by errors of stated poses that are far
    from those of the fit."""

    outputs: Array
    slopes: Array
    from_parameters: Array
    from_readings: LearntCovariance | None
    by_residuals: bool
    elsewhere: Array | None = None
    angles: Mapping[str, Array] = field(default_factory=dict)

    @property
    def covariance(self) -> Array:
        """(N, o, o) of both parts together, of the parameters alone where that is all."""
        if self.from_readings is None:
            return self.from_parameters
        return self.from_parameters + self.from_readings.matrix


def parts_at(
    calibrated: Predictor,
    data: Dataset,
    hidden: Collection[str] = (),
    *,
    noise: Noise | None = None,
    measured: bool = False,
) -> Parts:
    """What is stated of these poses by whoever asks.

    hidden: what no sensor reads: the loops find it with the outputs; noise: sds of the readings,
    else the calibration's; measured: at poses of the fit.
    """
    solved = solving(calibrated.mechanism, hidden)
    names, unused = solved.tape.quantities, solved.unused
    x = np.array([_readings(q, data, calibrated) for q in names])
    nothing = np.zeros(len(data))
    listed = [nothing if q in unused else data[q] for q in solved.tape.pose_constants]
    constants = np.array(listed).reshape(-1, len(data))
    values = np.array([p.nominal for p in solved.parameters])
    unread = _unread_joints(solved, x)
    x[unread] = 0.0
    y = predict_outputs(solved, values, x, constants, calibrated.names)
    x[[names.index(q) for q in solved.outputs]] = y
    for i, moved_by in enumerate(_moved_by(solved) if unread.any() else ()):
        y[i, unread[moved_by].any(axis=0)] = np.nan
    S = output_sensitivity(solved, values, calibrated.names, x, constants)
    o = len(calibrated.units)
    slopes, beside = with_followers(calibrated, solved, S.by_parameter[:, :o], x, constants)
    from_parameters = by_parameters(calibrated, slopes) + beside
    elsewhere = None if measured else _elsewhere(calibrated, solved, x, constants, S)
    if elsewhere is not None:
        from_parameters = from_parameters + elsewhere
    readings = _by_readings(calibrated, solved, data, noise, S.by_reading[:, :o])
    left = _left(calibrated, len(data)) if readings is None and noise is None else None
    return Parts(
        y[:o],
        slopes,
        from_parameters,
        left if readings is None else readings,
        left is not None,
        elsewhere,
        angles(solved, x, constants) if calibrated.seen else {},
    )


def _outside(
    calibrated: Predictor, at: Mapping[str, Array]
) -> tuple[NDArray[np.bool_] | None, list[str]]:
    """(N,) whether a corner is farther from the axis of its camera than any of the calibration, and
    a sentence for each camera: what a lens does there its images do not show."""
    far = {c: at[c].max(axis=1) > most for c, most in calibrated.seen.items() if c in at}
    words = [
        f"EXTRAPOLATION  in {int(beyond.sum())} of {len(beyond)} poses {camera!r} is to see corners"
        f" up to {np.degrees(at[camera].max()):.0f} deg from its axis. Its images show the lens up "
        f"to {np.degrees(calibrated.seen[camera]):.0f} deg only: take images with the board there."
        for camera, beyond in far.items()
        if beyond.any()
    ]
    return (np.any(list(far.values()), axis=0) if far else None), words


def _elsewhere(
    calibrated: Predictor, solved: Mechanism, x: Array, constants: Array, S: Sensitivity
) -> Array | None:
    """(N, o, o) what errors of stated poses add where they are not those that the fit has met:
    the parameters took up other ones, and the new ones are as large as these."""
    smooth, part = calibrated.smooth_errors, calibrated.pose_part
    if smooth is None or part is None:
        return None
    names, columns, o = solved.tape.quantities, [*solved.tape.pose_constants], len(calibrated.units)
    at = [x[names.index(q)] for q in POSITION] + [constants[columns.index(c)] for c in COLUMNS]
    by_pose = S.by_reading[:, :o][:, :, [names.index(q) for q in QUANTITIES]]
    by_parameter = S.by_parameter[:, :o]
    added = rows_times(by_parameter, part) @ by_parameter.transpose(0, 2, 1)
    added += (by_pose * np.array(smooth.variances)) @ by_pose.transpose(0, 2, 1)
    share = calibrated.factor * unknown_share(smooth, np.array(at).T)
    return np.asarray(share[:, None, None] * added)


def _unread_joints(mechanism: Mechanism, x: Array) -> NDArray[np.bool_]:
    """(k, N) joints of a whole robot that a pose does not read: what others move is predicted."""
    tree, names = mechanism.tree, mechanism.tape.quantities
    joints = mechanism.joints if tree is not None and len(tree.leaves) > 1 else {}
    return np.isnan(x) & np.isin(names, list(joints))[:, None]


def _moved_by(mechanism: Mechanism) -> list[list[int]]:
    """By output, the positions of the quantities of its loop."""
    tape = mechanism.tape
    depends = dict(zip(tape.loops, tape.depends_on("quantity"), strict=True))
    return [[tape.quantities.index(n) for n in depends.get(q, ())] for q in mechanism.outputs]


def _guessed(calibrated: Predictor, data: Dataset, noise: Noise | None) -> set[str]:
    """Quantities whose columns are no readings: no sensor read them, here or in the calibration."""
    guessed = set(calibrated.readings.unmeasured)
    for key, value in ({} if noise is None else noise.entries).items():
        names = key if isinstance(key, tuple) else calibrated.mechanism.quantity_group(key)
        unmeasured = isinstance(value, np.ndarray) and bool(np.isinf(value).all())
        guessed = guessed.union(names) if unmeasured else guessed.difference(names)
    return guessed - {q for q, sds in data.sds.items() if np.isfinite(sds).any()}


def _check_enough(mechanism: Mechanism, missing: Sequence[str]) -> None:
    loops, outputs = len(mechanism.tape.loops), len(mechanism.outputs)
    if len(missing) + outputs > loops:
        raise InputError(
            f"there are no readings of {', '.join(map(repr, missing))}, and {loops} loop "
            f"equations have the {outputs} outputs to find already",
            code="missing-reading",
            remedy="give the readings of every quantity but the outputs; state the sd of one that "
            "the calibration did not measure",
        )


def _readings(quantity: str, data: Dataset, calibrated: Predictor) -> Array:
    """Readings (N,), or a start for what is found; a disturbance of the model is zero."""
    if quantity in calibrated.units or quantity not in data.readings:
        start = (
            0.0
            if quantity in calibrated.mechanism.disturbances
            else calibrated.typical.get(quantity, 0.0)
        )
        column = data.readings.get(quantity, np.full(len(data), np.nan))
        return np.where(np.isnan(column), start, column)
    return np.array(data.readings[quantity])


def _by_readings(
    calibrated: Predictor, solved: Mechanism, data: Dataset, noise: Noise | None, S: Array
) -> LearntCovariance | None:
    """C_x = S_x Sigma S_x^T, (N, o, o); None where the sd of a reading is not known.

    Sds of the calibration that were learnt there have errors in common with its parameters. Where
    it took these readings as exact, the learnt sds of the outputs count in their place. These
    sds hold what the readings and the machine do beside the model.
    """
    names = solved.tape.quantities
    entries: dict[str | tuple[str, ...], Any] = dict.fromkeys(solved.outputs, 0.0)
    read = [q for q in names if q not in solved.outputs]
    reading_noise = calibrated.readings
    slopes = np.zeros((len(calibrated.covariance.slopes), len(names)))
    if noise is None:
        if any(q not in reading_noise.sds and q not in data.sds for q in read):
            return None
        noise = Noise(
            {q: reading_noise.sds.get(q, 0.0) for q in read} | _marginal(reading_noise.joint, read)
        )
        learnt = {q: s for q, s in reading_noise.slopes.items() if q in read and q not in data.sds}
        if not any(reading_noise.sds.get(q, 0.0) or q in data.sds for q in read):
            S = S.copy()
            for i, q in enumerate(calibrated.units):
                S[:, i, names.index(q)] = 1.0
            of_outputs = [q for q in calibrated.units if q in reading_noise.learnt]
            learnt = {q: s for q, s in reading_noise.slopes.items() if q in of_outputs}
            entries |= {q: reading_noise.sds[q] for q in of_outputs}
        for q, relative in learnt.items():
            slopes[:, names.index(q)] = relative
    # What is found moves nothing by itself: any sd will do for it.
    noise = Noise(entries | noise.entries)
    zeros = {q: np.zeros(len(data)) for q in names if q not in data.readings}
    readings = {q: np.nan_to_num(v) for q, v in data.readings.items()} | zeros
    uncertainty = resolve_noise(
        noise, replace(data, readings=readings), names, solved.quantity_group
    )
    G = uncertainty.through(S)
    # Outputs are exact here: of the hundreds of quantities of a camera those of a pose are left.
    moving = np.flatnonzero(G.any(axis=(0, 1)))
    G, slopes = G[:, :, moving], slopes[:, moving]
    turned = G.transpose(0, 2, 1)
    covariance = G @ turned
    return LearntCovariance(covariance, covariance, (G * slopes[:, None, None, :]) @ turned)


def _left(calibrated: Predictor, poses: int) -> LearntCovariance | None:
    """The residual variance of each output (N, o, o), as unsure as the parameters' that it scales;
    None where it is not known."""
    sds = {(one.instrument, one.unit): one.residual for one in calibrated.usual}
    variance = np.full(len(calibrated.units), np.nan)
    for group in output_groups(calibrated.mechanism):
        sd = sds.get((group.instrument, group.unit))
        variance[list(group.rows)] = np.nan if sd is None else sd**2
    if not np.isfinite(variance).all():
        return None
    matrix = unsure = np.diag(variance)
    if calibrated.shared:  # the variance of single pixels comes from thousands of them
        factor = np.array([calibrated.shared[q] for q in calibrated.units])
        unsure = factor @ factor.T
        matrix = matrix + unsure
    C = calibrated.covariance
    relative = np.einsum("aii->a", C.slopes) / max(float(np.trace(C.plain)), 1e-300)
    every = np.broadcast_to(matrix, (poses, *matrix.shape))
    slopes = np.multiply.outer(relative, np.broadcast_to(unsure, every.shape))
    return LearntCovariance(every, every, slopes)


def _marginal(
    joint: Mapping[tuple[str, ...], Array], read: Sequence[str]
) -> dict[str | tuple[str, ...], Any]:
    """The joint covariances of those of their quantities that are read."""
    covariances: dict[str | tuple[str, ...], Any] = {}
    for names, matrix in joint.items():
        index = [i for i, name in enumerate(names) if name in read]
        if index:
            covariances[tuple(names[i] for i in index)] = matrix[np.ix_(index, index)]
    return covariances


def _ratio(from_parameters: Array, calibrated: Predictor) -> Array:
    usual = {(one.instrument, one.unit): one.sd for one in calibrated.usual}
    ratios = [
        trace_sd(from_parameters, group) / max(usual[group.instrument, group.unit], 1e-300)
        for group in output_groups(calibrated.mechanism)
        if (group.instrument, group.unit) in usual
    ]
    return np.max(ratios, axis=0) if ratios else np.full(len(from_parameters), np.nan)
