"""What a comparison knows of a calibration: from a result, or from what was written of it."""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from loopcal.arrays import Array
from loopcal.document.choice import TermEntry
from loopcal.document.findings import (
    LensErrorEntry,
    PredictionEntry,
    PrintedEntry,
    SmoothErrors,
)
from loopcal.document.fit import ChiSquared, CovarianceEntry, NoiseEntry
from loopcal.document.plain import symmetric
from loopcal.document.result_document import ResultDocument
from loopcal.document.verdict import Answer
from loopcal.estimation.dependence.stated_poses import unknown_share
from loopcal.estimation.noise.prints import weighed
from loopcal.estimation.result import FitResult
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parallel.free_body import COLUMNS, POSITION
from loopcal.mechanisms.structure.smooth import FurtherWaves, scaled
from loopcal.small_samples import LearntCovariance
from loopcal.statistics.printed import Offsets
from loopcal.statistics.scatter import Scatter, scatter

if TYPE_CHECKING:
    from loopcal.statistics.lens_fields import LensField


@dataclass(frozen=True)
class ResidualVariance:
    """Of a loop equation [SI squared], from residuals with so many degrees of freedom; shared:
    output -> what errors that an image shares do to it beside that (`PredictionEntry`)."""

    value: float
    freedom: float
    shared: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    def root(self, names: Sequence[str]) -> Array:
        """(o, q + o) of the covariance of these outputs."""
        alone = math.sqrt(self.value) * np.eye(len(names))
        if not self.shared:
            return alone
        return np.hstack([np.array([self.shared[name] for name in names]), alone])


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A calibrated machine and how sure it is.

    mechanism: with the calibrated values; covariance: (n_all, n_all) [SI], zero for fixed
    parameters; undetermined: (n_all, d) steps [SI] that neither data nor prior limit; nominal,
    prior_sd: (n_all,) what was known before; poses: its readings; data: what tells the readings
    apart from others; rejected: chi-squared, where it rejects the stated sds; terms: what was
    learnt of the model error; noise: the sds of its sensors;
    residual: of a method that takes the readings as exact; gain: the covariance at the sds that the
    fit used, were no residuals dependent, by which the prior weighed; None is `covariance`;
    scatter: the covariance (n_all, n_all) that the poses themselves show, where it is known;
    hidden: quantities that no sensor reads, and where they usually are [SI]; conditions: in which
    it was measured (`FitResult.conditions`); sound: what its verdict says of it, None of a fit that
    was not judged; pose_part: (n_all, n_all) of the covariance (`FitResult.pose_part`), and
    smooth_errors, which say how far poses are from those of the fit; offsets: what the points of
    prints leave open, of which covariance says nothing; fields: what lenses leave, whose part of
    the covariance other images of the same camera share; further_waves: errors of the machine that
    its discrepancy has no waves for, which the covariance holds as errors of the parameters.
    """

    name: str
    mechanism: Mechanism
    covariance: LearntCovariance
    undetermined: Array
    nominal: Array
    prior_sd: Array
    poses: Dataset | None
    data: str | None
    rejected: ChiSquared | None
    terms: tuple[TermEntry, ...]
    noise: tuple[NoiseEntry, ...] = ()
    residual: ResidualVariance | None = None
    gain: Array | None = None
    scatter: Scatter | None = None
    hidden: Mapping[str, float] = field(default_factory=dict)
    conditions: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    sound: Answer | None = None
    pose_part: Array | None = None
    smooth_errors: SmoothErrors | None = None
    offsets: Offsets | None = None
    fields: tuple[LensField, ...] = ()
    further_waves: tuple[FurtherWaves, ...] = ()

    @classmethod
    def of(cls, result: FitResult, name: str) -> Calibrated:
        """From a result."""
        system, parameters = result.spectrum, result.mechanism.parameters
        exact = result.fit.solver.exact
        seen = scatter(result)
        loose = system.scale[:, None] * system.directions[:, ~system.kept]
        free, size = result.problem.free, len(parameters)
        return cls(
            name,
            result.calibrated,
            result.learnt_covariance.within(size, free),
            _rows(loose, free, size),
            np.array([p.nominal for p in parameters]),
            np.array([math.inf if exact else p.prior_sd for p in parameters]),
            result.dataset,
            result.dataset.source.sha256 or str(id(result.dataset)),
            rejected_by(result.chi_squared, result.variance_factor_applied),
            result.terms,
            result.noise,
            residual_variance(result) if exact else None,
            LearntCovariance.certain(weighed(result.prints, system)).within(size, free).matrix,
            seen and seen.through(np.eye(size)[:, free]),
            _hidden(result),
            result.conditions,
            pose_part=_square(result.pose_part, free, size),
            smooth_errors=result.smooth_errors,
            offsets=_offsets(result.printed, parameters.names, result.estimated),
            fields=_fields(
                () if result.lens_errors is None else result.lens_errors.entries,
                np.eye(size)[:, free],
            ),
            further_waves=tuple(
                one.through(np.eye(size)[:, free]) for one in further_waves(result)
            ),
        )

    @classmethod
    def from_document(
        cls, document: ResultDocument, mechanism: Mechanism, poses: Dataset | None, name: str
    ) -> Calibrated:
        """From the content of result.json and the calibrated mechanism beside it."""
        names = mechanism.parameters.names
        entries = {entry.name: entry for entry in document.parameters}
        estimated = document.covariance.names
        free = np.array([names.index(n) for n in estimated], dtype=np.intp)
        stored = document.prediction
        if stored is not None and stored.covariance is not None:
            determined = stored.covariance
            loose = np.array(stored.undetermined, dtype=float).reshape(-1, len(free)).T
        else:
            # a parameter without covariance is one that nothing limits
            matrix = np.array(document.covariance.matrix, dtype=float).reshape((len(free),) * 2)
            determined, loose = None, np.eye(len(free))[:, np.isnan(np.diag(matrix))]
        covariance = stored_covariance(document.covariance, determined)
        prior = [entries[n].prior_sd for n in names]
        exact = document.sensors_exact
        seen, stated = Scatter.of(document.covariance), document.covariance.unwidened
        unwidened = None if stated is None else symmetric(stated)
        return cls(
            name,
            mechanism.with_nominal({n: entries[n].value for n in names}),
            covariance.within(len(names), free),
            _rows(loose, free, len(names)),
            np.array([entries[n].nominal for n in names]),
            np.array([math.inf if exact or sd is None else sd for sd in prior]),
            poses,
            document.data.sha256,
            rejected_by(document.chi_squared, document.variance_factor_applied),
            document.terms,
            document.noise,
            _stored_residual(document, covariance) if exact else None,
            None
            if unwidened is None
            else LearntCovariance.certain(unwidened).within(len(names), free).matrix,
            scatter=seen and seen.through(np.eye(len(names))[:, free]),
            hidden={} if stored is None else {q: stored.typical[q] for q in stored.unmeasured},
            conditions={} if stored is None else stored.conditions,
            sound=None if document.verdict is None else document.verdict.sound,
            pose_part=_square(stored_pose_part(document.covariance), free, len(names)),
            smooth_errors=None if stored is None else stored.smooth_errors,
            offsets=_offsets(None if stored is None else stored.printed, names, estimated),
            fields=_fields(document.lens_errors, np.eye(len(names))[:, free]),
            further_waves=tuple(
                one.through(np.eye(len(names))[:, free]) for one in stored_waves(stored, mechanism)
            ),
        )

    @property
    def carried(self) -> bool:
        """Whether parameters with learnt sds (terms) carry the error of the model."""
        return bool(self.terms)

    @property
    def factor(self) -> float:
        """By how much the residuals are larger than the stated variances say; 1 where not."""
        return residual_factor(self.rejected)

    @property
    def unwidened(self) -> Array:
        """(n_all, n_all) the covariance by which the fit weighed its prior: at the sds that it
        used, were no residuals dependent."""
        return self.covariance.plain if self.gain is None else self.gain

    @property
    def estimated(self) -> NDArray[np.bool_]:
        """(n_all,) the parameters that the calibration did not hold."""
        loose = np.abs(self.undetermined).max(axis=1, initial=0.0) > 0.0
        return np.asarray(loose | (np.diag(self.covariance.matrix) > 0.0))

    def through(self, mechanism: Mechanism, M: Array) -> Calibrated:
        """Of another description of the machine, whose parameters change by M (n, n_all) with
        these."""
        return replace(
            self,
            mechanism=mechanism,
            covariance=self.covariance.through(M),
            undetermined=M @ self.undetermined,
            gain=None if self.gain is None else M @ self.gain @ M.T,
            scatter=self.scatter and self.scatter.through(M),
            pose_part=None if self.pose_part is None else M @ self.pose_part @ M.T,
            offsets=self.offsets and self.offsets.through(M),
            fields=tuple(one.through(M) for one in self.fields),
            further_waves=tuple(one.through(M) for one in self.further_waves),
        )

    @property
    def with_offsets(self) -> Calibrated:
        """The same with the offsets of points among its parameters."""
        offsets = self.offsets
        if offsets is None:
            return self
        used = LearntCovariance.certain(self.unwidened)
        prior_sd = np.where(np.isfinite(offsets.prior_sd), offsets.prior_sd, self.prior_sd)
        covariance, carried = offsets.beside(self.covariance), offsets.carried
        part = self.pose_part
        return replace(
            self,
            covariance=covariance,
            undetermined=carried @ self.undetermined,
            prior_sd=prior_sd,
            gain=offsets.beside(used).matrix,
            pose_part=None if part is None else carried @ part @ carried.T,
            fields=tuple(one.through(carried) for one in self.fields),
            further_waves=tuple(one.through(carried) for one in self.further_waves),
        )

    @property
    def continuing(self) -> Calibrated:
        """For an update: with the offsets of points among its parameters, none of which is fixed
        that has a covariance."""
        one = replace(self.with_offsets, offsets=None)
        if self.offsets is None:
            return one
        every = one.mechanism.parameters
        open_ = [p.name for p, free in zip(every, one.estimated, strict=True) if free]
        return replace(
            one, mechanism=one.mechanism.with_parameters(every.with_fixed(open_, fixed=False))
        )

    def predicting(self, data: Dataset) -> Calibrated:
        """For other poses of the same robot, which share errors of its stated poses where they are
        near those of the fit."""
        part, unknown = self.pose_part, self.unknown_share(data)
        covariance = self.covariance.less(part)
        if part is not None and unknown is not None and self.smooth_errors is not None:
            covariance = covariance.widened(unknown.mean() * part, self.smooth_errors.spread)
        return replace(self, covariance=covariance, pose_part=None).with_offsets

    def unknown_share(self, data: Dataset) -> Array | None:
        """(N,) of the smooth errors of these poses (`unknown_share`); None without any."""
        columns = (*POSITION, *COLUMNS)
        if self.smooth_errors is None or not {*columns} <= {*data.readings}:
            return None
        return unknown_share(self.smooth_errors, np.array([data[c] for c in columns]).T)

    @property
    def stationed(self) -> Calibrated:
        """The same as a machine that can be placed anew (see `mechanisms.station`)."""
        from loopcal.mechanisms.station import stationed

        made, size = stationed(self.mechanism), len(self.nominal)
        E = np.eye(len(made.parameters))[:, :size]
        # A new station is placed by nothing but the readings of the day: flat.
        prior_sd = np.append(self.prior_sd, np.full(len(E) - size, math.inf))
        return replace(self.through(made, E), nominal=E @ self.nominal, prior_sd=prior_sd)

    @property
    def loadable(self) -> Calibrated:
        """The same as a machine that may give way under another load, by as much as arms usually
        do, where it was calibrated without such sag."""
        from loopcal.mechanisms.structure.structured import loadable

        return self._with_further(loadable(self.mechanism))

    def scalable(self, names: Container[str] | None = None) -> Calibrated:
        """The same as a machine whose slides may grow, where it was calibrated without these
        scales."""
        from loopcal.mechanisms.structure.structured import scalable

        return self._with_further(scalable(self.mechanism, names))

    def _with_further(self, made: Mechanism) -> Calibrated:
        """As a machine with further parameters, which are held at their nominal values."""
        if made is self.mechanism:
            return self
        E = np.equal.outer(made.parameters.names, self.mechanism.parameters.names).astype(float)
        prior_sd = np.array([p.prior_sd for p in made.parameters])
        prior_sd[E.any(axis=1)] = self.prior_sd[E.argmax(axis=1)[E.any(axis=1)]]
        return replace(self.through(made, E), nominal=E @ self.nominal, prior_sd=prior_sd)

    def drifted(self, drift: Array) -> Calibrated:
        """After independent changes of one sd along each column (n_all, k) [SI]."""
        Q = drift @ drift.T
        covariance = self.covariance
        added = LearntCovariance(Q, Q, 0.0 * covariance.slopes)
        return replace(self, covariance=covariance.plus(added), gain=self.unwidened + Q)

    @property
    def by_scatter(self) -> Calibrated:
        """With the covariance that its poses themselves show, where it is known."""
        if self.scatter is None:
            return self
        seen = LearntCovariance.certain(self.scatter.matrix)
        return replace(self, covariance=seen, gain=self.unwidened, fields=())

    @property
    def without_fields(self) -> Calibrated:
        """Without what lenses leave."""
        if not self.fields:
            return self
        part = np.sum([one.covariance for one in self.fields], axis=0)
        covariance = self.covariance.widened(-part)
        return replace(self, covariance=covariance, gain=self.unwidened, fields=())

    @property
    def by_residuals(self) -> Calibrated:
        """With a covariance as large as the residuals, where chi-squared rejects the sds."""
        return replace(self, covariance=by_residuals(self.covariance, self.rejected))


def _offsets(
    entry: PrintedEntry | None, names: Sequence[str], estimated: Sequence[str]
) -> Offsets | None:
    return None if entry is None else Offsets.of(entry, names, estimated)


def _fields(entries: Sequence[LensErrorEntry], place: Array) -> tuple[LensField, ...]:
    if not entries:
        return ()
    from loopcal.statistics.lens_fields import lens_fields  # of cameras alone

    return lens_fields(entries, place)


def further_waves(result: FitResult) -> tuple[FurtherWaves, ...]:
    """As its covariance has them: not where poses depend on each other by time."""
    return () if result.drifting is not None else waves_without_drift(result)


def waves_without_drift(result: FitResult) -> tuple[FurtherWaves, ...]:
    """The same where no drift is allowed for, whether or not these poses show one: the test of
    that costs as much as what follows from it."""
    return () if result.learnt is None else scaled(result.learnt.waves, result.applied_factor)


def stored_waves(stored: PredictionEntry | None, mechanism: Mechanism) -> tuple[FurtherWaves, ...]:
    """As a document has them, of the bodies of its mechanism."""
    if stored is None or mechanism.structure is None:
        return ()
    smooth = {one.body: one for one in mechanism.structure.smooth.values()}
    return tuple(
        FurtherWaves(smooth[one.body], one.sd, np.array(one.moved))
        for one in stored.further_waves
        if one.body in smooth
    )


def _hidden(result: FitResult) -> dict[str, float]:
    """The median of what the loops find of each quantity that no sensor reads in any pose."""
    problem, names = result.problem, result.problem.mechanism.tape.quantities
    return {
        names[i]: float(np.median(problem.readings[i] + result.corrections[names[i]]))
        for i in np.flatnonzero(np.isinf(problem.uncertainty.sd).all(axis=1)).tolist()
    }


def rejected_by(chi: ChiSquared | None, applied: bool) -> ChiSquared | None:
    """Chi-squared where it rejects the stated sds; applied: its factor is in the covariance."""
    return chi if chi is not None and chi.too_large and not applied else None


def residual_factor(rejected: ChiSquared | None) -> float:
    """By how much the residuals are larger than the stated variances say; 1 where not."""
    return 1.0 if rejected is None else rejected.variance_factor or 1.0


def by_residuals(covariance: LearntCovariance, rejected: ChiSquared | None) -> LearntCovariance:
    """As large as the residuals, where chi-squared rejects the sds."""
    if rejected is None:
        return covariance
    factor = residual_factor(rejected)
    if len(covariance.slopes):
        return covariance.scaled_by(factor)
    # Without slopes no sd was learnt: the factor itself is what the residuals leave unsure.
    return LearntCovariance.scaled(factor * covariance.matrix, rejected.degrees_of_freedom)


def _residual(squares: float, freedom: int) -> ResidualVariance | None:
    return ResidualVariance(squares / freedom, freedom) if freedom > 0 and squares > 0.0 else None


def residual_variance(result: FitResult) -> ResidualVariance | None:
    """Of a method that takes readings as exact."""
    images, names = result.image_errors, result.mechanism.tape.quantities
    if images is None:
        return _residual(result.solution.chi_squared, result.freedom)
    outputs = result.mechanism.outputs
    shared = {q: tuple(images.factor[names.index(q)].tolist()) for q in outputs}
    return ResidualVariance(images.sd**2, images.freedom, shared)


def _stored_residual(
    document: ResultDocument, covariance: LearntCovariance
) -> ResidualVariance | None:
    stored = document.prediction
    if stored is None or not stored.shared:
        return _residual(_squares(document), _freedom(document))
    sd = next(one.residual for one in stored.by if one.residual is not None)
    covariance = covariance.less(stored_pose_part(document.covariance))  # as `image_errors` has it
    return ResidualVariance(sd**2, float(covariance.freedom.min()), stored.shared)


def _values(document: ResultDocument) -> int:
    """How many loop values there are: equations, and what the loops find beside the parameters."""
    index, machine = document.identifiability.calibration_index, document.mechanism
    if index is None or machine is None:
        return 0
    unmeasured = len(machine.quantities) - len(document.data.quantities)
    return index.value + (unmeasured * document.data.used if index.value else 0)


def _squares(document: ResultDocument) -> float:
    """Sum of the squares of the loop values."""
    rms = document.closure.after.rms
    return 0.0 if rms is None else rms**2 * _values(document)


def _freedom(document: ResultDocument) -> int:
    index = document.identifiability.calibration_index
    return 0 if index is None else index.value - document.identifiability.rank


def _square(part: Array | None, free: NDArray[np.intp], size: int) -> Array | None:
    return None if part is None else LearntCovariance.certain(part).within(size, free).matrix


def _rows(part: Array, free: NDArray[np.intp], size: int) -> Array:
    whole = np.zeros((size, part.shape[1]))
    whole[free] = part
    return whole


# The covariance of a result's parameters, from what was written of it.


def stored_pose_part(entry: CovarianceEntry) -> Array | None:
    """As `FitResult.pose_part`."""
    return None if entry.pose_part is None else symmetric(entry.pose_part)


def stored_covariance(
    entry: CovarianceEntry, determined: Sequence[Sequence[float]] | None
) -> LearntCovariance:
    """The covariance over the determined directions, and how sure it is itself.

    determined: the matrix over these directions where the entry's own has gaps, for predictions.
    """
    n = len(entry.names)

    def square(rows: Sequence[Sequence[float | None]]) -> NDArray[np.float64]:
        # Null is what nothing limits: undetermined steps stand for it, and 0 here.
        return np.asarray(np.nan_to_num(np.array(rows, dtype=float)).reshape(n, n))

    matrix = square(entry.matrix if determined is None else determined)
    if determined is not None and (part := stored_pose_part(entry)) is not None:
        matrix = matrix + part
    plain = matrix if entry.plain is None else symmetric(entry.plain)
    slopes = np.array([symmetric(s) for s in entry.slopes]).reshape(-1, n, n)
    return LearntCovariance(matrix, plain, slopes)
