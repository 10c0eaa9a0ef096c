"""A fit as one value, and what follows from it: computed when it is first asked for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from loopcal.arrays import Array
from loopcal.document.change_points import Dependence
from loopcal.document.choice import Chosen, TermEntry
from loopcal.document.findings import ColumnFault, Identifiability, PrintedEntry, SmoothErrors
from loopcal.document.fit import ChiSquared, NoiseEntry
from loopcal.document.result_document import DataEntry, Parts
from loopcal.errors import InputError
from loopcal.estimation.accuracy import Accuracy, Apart, accuracy, deviations
from loopcal.estimation.all_poses import AllPoses
from loopcal.estimation.cameras.at_board import Sight, sights
from loopcal.estimation.dependence.dependence import (
    Depending,
    Drifting,
    covariance_under,
    dependence,
)
from loopcal.estimation.document_parts import absorbed, data_entry, identifiability, shares
from loopcal.estimation.fit import Fit
from loopcal.estimation.inherited import Inherited
from loopcal.estimation.noise.learning import entries, words
from loopcal.estimation.noise.term_parts import term_entries
from loopcal.estimation.noise.variances import all_learnt
from loopcal.estimation.prediction import output_differences
from loopcal.estimation.problem.constants import conditions_of
from loopcal.estimation.problem.pose_equations import PoseEquations, pose_equations
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.residuals import Closure, by_name, residuals
from loopcal.estimation.solve.reduction import Accumulator, Spectrum
from loopcal.estimation.solve.robust import RobustSums
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.solution import Solution, Status
from loopcal.lazy import cached_property, keep
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import PIXELS, Mechanism
from loopcal.small_samples import LearntCovariance

if TYPE_CHECKING:
    from loopcal.estimation.dependence.image_errors import ImageErrors
    from loopcal.estimation.dependence.lens_errors import LensErrors
    from loopcal.estimation.dependence.smooth_images import SmoothPart
    from loopcal.estimation.noise.estimation import NoiseEstimate
    from loopcal.estimation.noise.kenward_roger import LearntParameters
    from loopcal.estimation.noise.prints import Prints


@dataclass(frozen=True, eq=False)
class FitResult:
    """A fit. Values are SI; mappings go by name.

    fit: the settings; dataset: the readings; problem: with the sds used, solution: where the fit
    ended; stated: the problem with the sds as stated, estimate: what was learnt of them, None
    where nothing was; all_poses: of a stream; faults: of the file as a whole, found before the
    fit; inherited: of an update; parts: what its document holds beside the fit.
    What follows from these is computed when it is first asked for.
    """

    fit: Fit
    dataset: Dataset
    problem: Problem
    solution: Solution
    stated: Problem
    estimate: NoiseEstimate | None = None
    all_poses: AllPoses | None = None
    taken_as_independent: bool = False
    """Whether the covariance ignores what residuals of neighbouring poses say, on request."""
    variance_factor_applied: bool = False
    """Whether covariance and sds were multiplied by the variance factor, on request."""
    faults: tuple[ColumnFault, ...] = ()
    inherited: Inherited | None = None
    parts: Parts = field(default_factory=Parts)

    def __getstate__(self) -> dict[str, Any]:
        """What a worker sends: the fields; what follows from them is computed where it is asked."""
        return {one.name: getattr(self, one.name) for one in fields(self)}

    @property
    def method(self) -> str:
        """The name of the method."""
        return self.fit.method.name

    @property
    def loss(self) -> str:
        """The name of the loss."""
        return self.fit.loss

    @property
    def status(self) -> Status:
        """How the fit ended."""
        return self.solution.status

    @property
    def mechanism(self) -> Mechanism:
        """The nominal mechanism, placed where the instrument sees it."""
        return self.problem.mechanism

    @property
    def estimated(self) -> tuple[str, ...]:
        """The names of the estimated parameters, in the order of `covariance`."""
        return self.problem.names

    @property
    def spectrum(self) -> Spectrum:
        """The parameter system with the prior."""
        return self.solution.spectrum

    @property
    def information(self) -> Accumulator:
        """The parameter system without the prior."""
        return self.solution.data

    @property
    def freedom(self) -> int:
        """Degrees of freedom: loop equations + finite priors - determined parameters."""
        informed = int(np.count_nonzero(self.problem.precision))
        used = 0 if self.prints is None else round(self.prints.freedom)
        return self.solution.equations + informed - self.spectrum.rank - used

    def pose_equations(self, *, bare: bool = False) -> tuple[PoseEquations, ...]:
        """The equations of every pose where the fit ended, whitened as its method does; bare: to
        test residuals, without what lenses leave of them."""
        at, errors = self.solution, self.lens_errors if bare else None
        made = pose_equations(self.problem, at.parameters, at.corrections)
        return made if errors is None else errors.left(self.problem, at, made)

    @cached_property
    def value(self) -> Mapping[str, float]:
        """Every parameter."""
        every = self.mechanism.parameters
        value = dict(zip(every.names, self.solution.parameters.tolist(), strict=True))
        return MappingProxyType({p.name: value[p.same or p.name] for p in every})

    @cached_property
    def learnt_covariance(self) -> LearntCovariance:
        """Of the estimated parameters, and how sure it is itself: learnt sds are not known. Least
        squares has it from residuals. It allows for serial dependence where there is any, and for
        what lenses leave."""
        covariance, depending = self._independent, self._depending
        if depending is not None and depending.covariance is not None:
            covariance = LearntCovariance.certain(depending.covariance)
        elif self._smooth_part is not None:
            covariance = covariance.besides(*self._smooth_part)
        if self.lens_errors is not None:
            covariance = covariance.widened(self.lens_errors.covariance)
        return covariance if self.inherited is None else self.inherited.added_to(covariance)

    @property
    def _whole(self) -> bool:
        """Whether it converged, is of no stream and under no loss."""
        return self.all_poses is None and self.fit.robust_loss is None and self.status.converged

    @property
    def drifting(self) -> Drifting | None:
        """The drift that the covariance allows for, None without serial dependence."""
        return None if self._depending is None else self._depending.drifting

    @cached_property
    def pose_part(self) -> Array | None:
        """(n, n) what `covariance` gains by errors that near poses share, or joints that stand
        alike; None without any. Predictions leave it out: other poses share them too."""
        if self._smooth_part is not None:
            return self._smooth_part.part
        if self.drifting is not None or self.learnt is None or self.learnt.alike is None:
            return None
        root = self.learnt.root
        return np.asarray(self.applied_factor * root @ self.learnt.alike.gained @ root.T)

    @property
    def smooth_errors(self) -> SmoothErrors | None:
        """Of stated poses, for those far from these; None without, and of least squares."""
        if self.pose_part is None or self.learnt is None or self.learnt.alike is None:
            return None
        factor, smooth = self.applied_factor, self.learnt.alike.smooth
        return smooth and replace(smooth, variances=tuple(factor * v for v in smooth.variances))

    def covariance_through(self, S: Array, drifting: Drifting | None) -> LearntCovariance:
        """For predictions, without `pose_part`: of S (N, m, n) times the estimate, with a drift."""
        if drifting is not None:
            equations = self.pose_equations()
            under_drift = covariance_under(drifting, self.problem, self.solution, equations)
            covariance = LearntCovariance.certain(under_drift).through(S)
        else:
            learnt = None if self.variance_factor_applied else self.learnt
            covariance = ((learnt and replace(learnt, alike=None)) or self._independent).through(S)
        if self.lens_errors is not None:
            covariance = covariance.widened(self.lens_errors.through(S))
        return covariance if self.inherited is None else self.inherited.added_to(covariance, S)

    @property
    def learnt_noise(self) -> tuple[tuple[tuple[int, ...], Array], ...]:
        """Of each learnt sd of sensors: the quantities, by position, and the relative changes (a,)
        of its variance along the slopes of `covariance_through`."""
        if self.learnt is None or self.estimate is None:
            return ()
        stated = self.estimate.stated
        return tuple(zip((c.quantities for c in stated), self.learnt.relative, strict=True))

    @cached_property
    def _independent(self) -> LearntCovariance:
        loss, method = self.fit.robust_loss, self.fit.solver
        if loss is not None:
            sums = self.robust_sums if self.all_poses is None else self.all_poses.robust
            return LearntCovariance.certain(sums.covariance(self.spectrum, self.problem.prior_sd))
        if (images := self.image_errors) is not None:
            return LearntCovariance.scaled(images.covariance, images.freedom)
        if method.exact:
            return self._by_residuals()
        if self.learnt is not None:
            learnt = self.learnt.covariance
            return learnt.scaled_by(self.applied_factor) if self.variance_factor_applied else learnt
        if self.variance_factor_applied:
            return self._by_residuals()
        return LearntCovariance.certain(self.spectrum.covariance())

    @cached_property
    def image_errors(self) -> ImageErrors | None:
        """What least squares leaves in images beside the poses of a robot; None elsewhere."""
        if not self.fit.solver.exact or not self._whole:
            return None
        from loopcal.estimation.dependence.image_errors import image_errors  # where it is used

        return image_errors(self.problem, self.solution, self.pose_equations())

    @cached_property
    def lens_errors(self) -> LensErrors | None:
        """What no lens model describes; None without cameras, and beside `image_errors`."""
        cameras = self._whole and any(f.form == PIXELS for f in self.mechanism.families)
        if not cameras or self.image_errors is not None:
            return None
        from loopcal.estimation.dependence.lens_errors import lens_errors  # of cameras alone

        return lens_errors(self.problem, self.solution)

    @cached_property
    def _smooth_part(self) -> SmoothPart | None:
        """What errors of stated poses that are alike nearby add to `image_errors`."""
        images = self.image_errors if self.drifting is None else None
        if images is None:
            return None
        from loopcal.estimation.dependence.smooth_images import smooth_part  # where it is used

        C = self.spectrum.covariance()
        return smooth_part(self.problem, images, self.pose_equations(), C)

    def _by_residuals(self) -> LearntCovariance:
        """Scaled by the mean square of the residuals."""
        plain = self.spectrum.covariance()
        if self.freedom <= 0:
            return LearntCovariance.certain(np.full_like(plain, math.inf))
        variance = self.solution.chi_squared / self.freedom
        return LearntCovariance.scaled(plain * variance, self.freedom)

    @cached_property
    def learnt(self) -> LearntParameters | None:
        """Kenward and Roger's covariance, where sds were learnt by a fit that converged.

        A stream has too many poses for it to matter.
        """
        if self.estimate is None or self.all_poses is not None or not self.status.converged:
            return None
        from loopcal.estimation.noise.kenward_roger import learnt_parameters

        return learnt_parameters(self.estimate, self.pose_equations())

    @property
    def covariance(self) -> Array:
        """(n, n) of the estimated parameters."""
        return self.learnt_covariance.matrix

    @cached_property
    def degrees_of_freedom(self) -> Mapping[str, float | None]:
        """Of Student's t of every parameter: None if fixed, inf where its sd is known."""
        by_parameter: dict[str, float | None] = dict.fromkeys(self.mechanism.parameters.names)
        by_parameter |= dict(
            zip(self.estimated, self.learnt_covariance.freedom.tolist(), strict=True)
        )
        return MappingProxyType(by_parameter)

    @property
    def dependence(self) -> Dependence | None:
        """Whether residuals of neighbouring poses are alike; None of a stream, under a loss, or not
        converged. Where they depend on the pose order, a learnt drift is in `covariance`."""
        return None if self._depending is None else self._depending.entry

    @cached_property
    def _depending(self) -> Depending | None:
        if not self._whole or self.taken_as_independent:
            return None
        with one_blas_thread():
            return dependence(self.problem, self.solution, self.pose_equations(bare=True))

    @property
    def robust_sums(self) -> RobustSums:
        """What the covariance under a loss needs of the poses; nothing under the gaussian one."""
        loss = self.fit.robust_loss
        if loss is None:
            return RobustSums({})
        return RobustSums.of(self.problem, self.solution, loss)

    @cached_property
    def sd(self) -> Mapping[str, float | None]:
        """Of every parameter: None if fixed, inf if not identifiable."""
        sds: dict[str, float | None] = dict.fromkeys(self.mechanism.parameters.names)
        variances = np.diag(self.covariance).tolist()
        for name, variance in zip(self.estimated, variances, strict=True):
            loose = name in self.identifiability.loose
            sds[name] = math.inf if loose else math.sqrt(max(variance, 0.0))
        return MappingProxyType({p.name: sds[p.same or p.name] for p in self.mechanism.parameters})

    @cached_property
    def chi_squared(self) -> ChiSquared | None:
        """None where the method or the loss has none."""
        value = self.solution.chi_squared
        applicable = not self.fit.solver.exact and self.fit.robust_loss is None
        if not applicable or not math.isfinite(value):
            return None
        statistic = ChiSquared.of(value, self.freedom, absorbed(self.problem, self.terms))
        return replace(statistic, p_value=None) if self._all_sds_learnt else statistic

    @property
    def _all_sds_learnt(self) -> bool:
        """Whether chi-squared is what it is because the sds were chosen so."""
        learnt = self.estimate
        return bool(learnt and all_learnt(self.stated, [c.quantities for c in learnt.stated]))

    @cached_property
    def noise(self) -> tuple[NoiseEntry, ...]:
        """The sds that were used."""
        handed_on = () if self.inherited is None else self.inherited.noise
        if handed_on or self.fit.solver.exact:
            return handed_on
        relative = None
        if self.learnt is not None and self.drifting is None:  # a drift has no slopes
            relative = self.learnt.relative
        return entries(self.problem, self.estimate, self.stated, relative)

    @cached_property
    def terms(self) -> tuple[TermEntry, ...]:
        """What was learnt of each term of the mechanism; empty where nothing was."""
        if self.inherited is not None:
            return self.inherited.terms
        if self.estimate is None:
            return ()
        learnt, prints = self.estimate.variances.terms, self.estimate.prints
        terms = () if learnt is None else term_entries(self.mechanism, learnt)
        return terms if prints is None else (*terms, *prints.entries(self.mechanism))

    @property
    def prints(self) -> Prints | None:
        """The offsets of points of prints."""
        return None if self.estimate is None else self.estimate.prints

    @cached_property
    def printed(self) -> PrintedEntry | None:
        """What the points of prints leave open (`Prints.left`)."""
        return None if self.prints is None else self.prints.left()

    @property
    def learns_terms(self) -> bool:
        """Whether there are any `terms`, of which nothing else is computed."""
        if self.inherited is not None:
            return bool(self.inherited.terms)
        if self.estimate is None:
            return False
        learnt, prints = self.estimate.variances.terms, self.estimate.prints
        asked = prints is not None and prints.learnt is not None and bool(prints.kept.any())
        return asked or (learnt is not None and bool(learnt.system.terms))

    def terms_with_parts(self) -> tuple[TermEntry, ...]:
        """With what each term does joint by joint."""
        if not self.terms or not self.problem.count or self.inherited is not None:
            return self.terms
        from loopcal.estimation.noise.term_parts import with_parts

        at = self.solution.parameters, self.solution.corrections
        terms = with_parts(self.terms, self.problem, *at, self.covariance)
        printed = {} if self.prints is None else self.prints.parts()
        return tuple(
            replace(term, parts=tuple(printed[term.name])) if term.name in printed else term
            for term in terms
        )

    @cached_property
    def corrections(self) -> Mapping[str, Array]:
        """Quantity -> (N,) estimated true value minus reading."""
        return by_name(self.mechanism.tape.quantities, self.solution.corrections)

    @cached_property
    def reading_sds(self) -> Mapping[str, Array]:
        """Quantity -> (N,) sds that were used."""
        sds = np.broadcast_to(self.problem.uncertainty.sd, self.solution.corrections.shape)
        return by_name(self.mechanism.tape.quantities, sds)

    @cached_property
    def sights(self) -> tuple[Sight, ...]:
        """What the images say of the place of the body, by camera; none of a stream."""
        if self.all_poses is not None:
            return ()
        return sights(self.problem, self.solution.parameters, self.solution.corrections)

    @cached_property
    def residuals_before(self) -> Mapping[str, Array]:
        """Loop -> (N,) values of the loop equations at the nominal parameters."""
        return residuals(self.problem, self.problem.start)

    @cached_property
    def residuals_after(self) -> Mapping[str, Array]:
        """Loop -> (N,) values of the loop equations at the corrected readings."""
        return residuals(self.problem, self.solution.parameters, self.solution.corrections)

    @cached_property
    def differences_before(self) -> Mapping[str, Array]:
        """What is compared -> (N,) computed minus measured at the nominal parameters.

        The outputs, and the small turns from measured to computed orientations.

        Computed from the readings of the rest; quantities that no sensor reads come from the loops.
        """
        return self._differences(self.problem.start)

    @cached_property
    def differences_after(self) -> Mapping[str, Array]:
        """What is compared -> (N,) computed minus measured at the calibrated parameters."""
        return self._differences(self.solution.parameters, self.solution.corrections)

    def _differences(
        self, parameters: Array, corrections: Array | None = None
    ) -> Mapping[str, Array]:
        names = self.mechanism.compared
        if not names:
            return MappingProxyType({})
        return by_name(names, output_differences(self.problem, parameters, corrections))

    @cached_property
    def accuracy_before(self) -> Accuracy | None:
        """Of the nominal machine; None without outputs, or where no pose shows it."""
        if self.all_poses is not None:
            return self.all_poses.accuracy_before
        return accuracy(self.deviations(self.differences_before))

    @cached_property
    def accuracy_after(self) -> Accuracy | None:
        """Of the calibrated machine."""
        if self.all_poses is not None:
            return self.all_poses.accuracy_after
        return accuracy(self.deviations(self.differences_after))

    def deviations(self, differences: Mapping[str, Array]) -> tuple[Apart, ...]:
        """Distances by instrument and pose of computed minus measured values."""
        if not differences:
            return ()
        rows = [self.mechanism.tape.quantities.index(q) for q in differences]
        off = np.array(list(differences.values()))
        return deviations(self.mechanism, self.problem.readings[rows], off)

    @property
    def closure_before(self) -> Closure:
        """Loop values at the readings and the start parameters."""
        return Closure.of(self.residuals_before)

    @property
    def closure_after(self) -> Closure:
        """Loop values at the corrected readings and the calibrated parameters."""
        return Closure.of(self.residuals_after)

    @cached_property
    def identifiability(self) -> Identifiability:
        """What the poses determine."""
        return identifiability(self.problem, self.solution)

    @cached_property
    def model_discrepancy(self) -> float | None:
        """sd [unit of the outputs] of an error of the machine model at the end point that would
        explain a chi-squared too large for the stated sds; None where it is not."""
        if self.all_poses is not None:
            return self.all_poses.model_discrepancy
        chi = self.chi_squared
        if not self.status.converged or chi is None or not chi.too_large:
            return None
        from loopcal.estimation.noise.variance_components import model_discrepancy

        return model_discrepancy(self.problem, self.solution)

    @property
    def restricted_criterion(self) -> float | None:
        """-2 log of the restricted likelihood, up to a constant of the readings, where sds were
        estimated: the difference between two models of the same readings is what counts."""
        if self.estimate is None or self.all_poses is not None:
            return None
        return self.estimate.criterion

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the reader must know before using the result."""
        lines = [*self.data_entry.warnings(), *self.identifiability.warnings()]
        if self.status.converged and self.status.note:
            lines.insert(0, self.status.note)
        if self.mechanism.placement is not None:
            lines += self.mechanism.placement.advice(self.value)
        if self.chi_squared is not None:
            unit = next((self.mechanism.quantities[q] for q in self.mechanism.outputs), "")
            lines += self.chi_squared.warnings(self.model_discrepancy, unit)
        if self.estimate is not None:
            lines += words(self.estimate, self.noise, self.chi_squared_shares)
        if self.dependence is not None:
            lines += self.dependence.warnings()
        return (*lines, *self.parts.notes)

    def with_parts(self, **parts: Any) -> Self:
        """The same fit, with these beside it: fields of `Parts`."""
        made = replace(self, parts=replace(self.parts, **parts))
        keep(self, made, FitResult)
        return made

    @property
    def errors(self) -> Mapping[str, float] | None:
        """True minus estimated value [SI] of the parameters whose truth is known."""
        return self.parts.errors

    def noted(self, *notes: str) -> Self:
        """The same result with further warnings."""
        return self.with_parts(notes=(*self.parts.notes, *notes))

    def as_if_independent(self) -> Self:
        """The same result, whose covariance takes the errors of all poses as independent.

        The covariance of the methods as they were published; where residuals depend on the pose
        order it is too small.
        """
        return replace(self, taken_as_independent=True)

    def with_variance_factor(self) -> Self:
        """The same result with its covariance multiplied by the variance factor.

        For those who trust the proportions of the stated sds but not their size: the corrections
        then say how large they are. The covariances are absolute otherwise. Raises InputError
        where there is no variance factor: least squares scales by the residuals anyway, and
        under a robust loss there is no chi-squared.
        """
        if self._variance_factor is None:
            raise InputError(
                f"the method {self.method!r} with the loss {self.loss!r} has no variance factor",
                code="unsupported",
                remedy="use the implicit loop or reweighted method with the gaussian loss",
            )
        return self if self.variance_factor_applied else replace(self, variance_factor_applied=True)

    @property
    def applied_factor(self) -> float:
        """The variance factor by which covariance and sds were multiplied; 1 without."""
        return (self._variance_factor or 1.0) if self.variance_factor_applied else 1.0

    @property
    def _variance_factor(self) -> float | None:
        return None if self.chi_squared is None else self.chi_squared.variance_factor

    @property
    def chi_squared_shares(self) -> Mapping[str, float]:
        """What the corrections of each quantity contribute to chi-squared; they add up to 1."""
        return shares(self.corrections, self.reading_sds)

    @property
    def calibrated(self) -> Mechanism:
        """The mechanism with the calibrated values as its nominal ones."""
        return self.mechanism.with_nominal(self.value)

    @property
    def data_entry(self) -> DataEntry:
        """Which readings were used."""
        return data_entry(self.dataset, self.solution.poses, [*self.mechanism.quantities])

    @property
    def conditions(self) -> dict[str, tuple[float, float]]:
        """Known column (temperature, load) -> its range [SI] here and in what was updated."""
        ranges = {} if self.inherited is None else dict(self.inherited.conditions)
        for name, (low, high) in conditions_of(self.mechanism, self.problem.pose_constants).items():
            before = ranges.get(name, (low, high))
            ranges[name] = min(low, before[0]), max(high, before[1])
        return ranges

    @property
    def chosen(self) -> Chosen | None:
        """What the method "auto" chose; None: the method was stated."""
        return self.parts.chosen

    def __repr__(self) -> str:
        state = "converged" if self.status.converged else self.status.reason
        return f"<Result: {self.method}, {state}, {len(self.estimated)} parameters>"
