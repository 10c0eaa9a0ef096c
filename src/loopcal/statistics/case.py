"""A calibration as it was asked for, ready to be made of all its poses or of some.

The candidates of a choice: the methods, with a model error and without, and the drawing.

The nominal machine, placed and mounted as well as can be: what a calibration must beat.

Only where machine and instruments stand, and where targets and tools sit on the body, is estimated;
all dimensions stay the drawing's. What is mounted is known to some millimetres: left free it would
run away to make up for a wrong machine, and the comparison would flatter the drawing.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.calibrate import calibrate, may_be_faulty
from loopcal.estimation.fit import Fit, instrument_noise, modelled
from loopcal.estimation.methods import implicit_loop, least_squares
from loopcal.estimation.problem.problem import Weighting
from loopcal.estimation.result import FitResult
from loopcal.estimation.solve.solver import Progress
from loopcal.estimation.steps import Near
from loopcal.lazy import cached_property
from loopcal.measurements.copies import copies
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.effects.effect import OF_INSTRUMENTS
from loopcal.mechanisms.mechanism import PIXELS, Mechanism
from loopcal.mechanisms.structure.structured import mounted, without

Index = NDArray[np.intp]


# Chosen, not derived (record 0157): those that converge take some 2 to 15.
NEAR = 200
"""Iterations of a fit that begins where another one of the same readings ended."""


@dataclass(frozen=True, eq=False)
class Begin:
    """Where another calibration of the same poses ended [SI].

    ended: its parameters; nominal: the machine as drawn, where that calibration placed it.
    """

    ended: Mapping[str, float]
    nominal: Mapping[str, float]

    @classmethod
    def of(cls, whole: FitResult, mechanism: Mechanism) -> Begin:
        """Of the parameters that this mechanism has; what it alone holds begins as stated."""
        names = mechanism.parameters.names
        parameters = whole.mechanism.parameters
        held = {p.name for p in mechanism.parameters if p.fixed} & {*parameters.free}
        return cls(
            {n: value for n, value in whole.value.items() if n in names and n not in held},
            {p.name: p.nominal for p in parameters if p.name in names},
        )


@dataclass(frozen=True, eq=False)
class Case:
    """A calibration as it was asked for."""

    mechanism: Mechanism
    data: Dataset
    noise: Noise | None
    fit: Fit
    near: Near | None = None
    """Where a fit of these readings ended."""
    trusted: bool = False
    """Whether faults of the file were sought, and there are none."""
    begin: Begin | None = None
    """Where the calibration of all poses begins. That of some begins as asked: what it leaves open
    must not stand where the other poses put it."""

    @cached_property
    def copied(self) -> Index:
        """Positions of the rows that copy others."""
        mechanism = self.mechanism
        return copies(self.data, mechanism.recorded, mechanism.outputs).copied

    @property
    def may_be_faulty(self) -> bool:
        """Whether its calibration would seek faults of the file."""
        return not self.trusted and may_be_faulty(self.mechanism, self.data, self.noise, self.fit)

    def discarding(self, outliers: Index) -> Case:
        """The case without the poses at these positions."""
        if not outliers.size:
            return self
        kept = np.setdiff1d(np.arange(len(self.data)), outliers)
        data, noise = self.data.without_outliers(outliers), taken(self.noise, kept)
        return replace(self, data=data, noise=noise)

    def calibrated(self, index: Index | None = None, progress: Progress | None = None) -> FitResult:
        """The calibration of these poses, by default of all; what copies are, all rows say.

        progress: called at every iteration.
        """
        mechanism, data, fit = self.mechanism, self.data, self.fit
        begin = self.begin if index is None else None
        if begin is not None:
            mechanism = mechanism.with_nominal(begin.nominal)
            most = min(fit.max_iterations, NEAR)
            fit = replace(fit, start=begin.ended, max_iterations=most)
        if index is not None:
            index = index[~np.isin(index, self.copied)]
            # Copies were sought in all poses; a part might judge the same rows otherwise.
            data = replace(data, source=replace(data.source, judged=True)).take(index)
        noise = taken(self.noise, index)
        near = self.near if self.near is None or index is None else self.near.take(index)
        result = calibrate(
            mechanism,
            data,
            noise=noise,
            fit=fit,
            progress=progress,
            near=near,
            trusted=self.trusted,
        )
        if begin is None:
            return result
        # The nominal machine is compared where it was placed, not where this fit began.
        problem = result.problem.with_nominal(result.mechanism)
        return replace(result, fit=self.fit, problem=problem)


def taken(noise: Noise | None, index: Index | None) -> Noise | None:
    """The noise of the poses at these positions; index None takes all."""
    return noise if noise is None or index is None else noise.take(index)


NOMINAL = "nominal"


@dataclass(frozen=True, eq=False)
class Entrant:
    """One way to calibrate.

    name: for the reader; case: what to calibrate, and how; structured: with terms for the model
    error; drawn: nothing but placement and mounting is estimated.
    """

    name: str
    case: Case
    structured: bool = False
    drawn: bool = False

    @property
    def cheap(self) -> bool:
        """Whether it is what every calibration is compared with: the nominal machine, or exact."""
        return self.drawn or (self.case.fit.method.exact and not self.structured)


def entrants(
    case: Case, moved: Collection[str] = (), made: Mechanism | None = None
) -> Iterator[Entrant]:
    """All that compete for a case: those with a model error first, the nominal machine last.

    moved: parameters of what slipped during the run, which all of them estimate; made: the machine
    with its model error, where it is at hand.
    """
    fit, lossless = case.fit, case.fit.robust_loss is None
    methods = fit.among(case.data, case.noise)
    machine, with_error = fit.with_prior(case.mechanism), fit.changed(model_error="structured")
    pixels = {q for f in case.mechanism.families if f.form == PIXELS for q in f.readings}
    images = bool(pixels)
    # Cameras alone: no joint and no pose is read that could count as exact.
    alone = images and not any(q in case.data.readings for q in {*machine.quantities} - pixels)
    if made is None and images:
        made = machine  # what is smooth in pixels is the lens's as well as the arm's
    if made is None:
        made = modelled(with_error, machine, case.data) if lossless else machine
    for method in methods if len(made.terms) > len(machine.terms) else ():
        if method.weighting is Weighting.READ:
            continue  # the noise of the model error says nothing about the parameters anyway
        # the mechanism has the prior already
        error_fit = with_error.changed(method=method, prior=None)
        name = f"{method.name} with model error"
        yield Entrant(name, replace(case, mechanism=made, fit=error_fit), True)
    for method in methods:
        if images and (
            method.weighting is Weighting.READ or (method.exact and (machine.joints or alone))
        ):
            # The weights of images cost as much as a fit; without its drawing's priors an arm that
            # pixels alone see lies in a valley.
            continue
        plain = fit.changed(method=method, model_error="none")
        yield Entrant(method.name, replace(case, fit=plain))
    # Without stated lens and joints nothing is drawn but the print: all else would be the same fit
    # with other weights, one sd for all cameras, and poses exact.
    stated = {*machine.parameters.of_role("lens")} - unstated_lenses(machine)
    if case.mechanism.outputs and (stated or machine.joints or not images):
        drawn = nominal_case(case, moved)
        if images and not (machine.joints or alone):
            # Poses count as exact: only least squares states what images share by their errors.
            exact = drawn.fit.changed(method=least_squares.METHOD)
            drawn = replace(drawn, noise=None, fit=exact)
        if (
            drawn.mechanism.parameters.free
        ):  # else the accuracy before the fit is that of the drawing
            yield Entrant(NOMINAL, drawn, drawn=True)


def without_terms(case: Case, one: Entrant, terms: Collection[str]) -> Entrant | None:
    """A structured candidate without terms of these names; None where that changes nothing.

    What the user has structured stays as it was stated.
    """
    machine, made = case.fit.with_prior(case.mechanism), one.case.mechanism
    if machine.structure is not None or not terms:
        return None
    fewer = without(machine, made, terms)
    if len(fewer.terms) == len(made.terms):
        return None
    return replace(one, case=replace(one.case, mechanism=fewer))


def nominal_case(case: Case, moved: Collection[str] = ()) -> Case:
    """The nominal machine, placed and mounted by readings of instruments weighted alike."""
    mechanism = nominal_machine(case.fit.with_prior(case.mechanism), moved)
    noise = instrument_noise(mechanism, case.data)
    fit = case.fit.changed(
        method=implicit_loop.METHOD, loss="gaussian", prior=None, model_error="none"
    )
    return Case(mechanism, replace(case.data, sds={}), noise, fit)


def unstated_lenses(mechanism: Mechanism) -> set[str]:
    """Parameters of lenses whose focal length is free without any prior: where the search begins
    comes from the same images, so that it is no statement to compare with."""
    parameters = mechanism.parameters
    lens = parameters.of_role("lens")
    free = [n for n in lens if n.endswith("_f") and math.isinf(parameters[n].prior_sd)]
    return {n for n in lens for f in free if n.startswith(f.removesuffix("f"))}


def instruments_alone(mechanism: Mechanism) -> set[str]:
    """Parameters of drifts and scales of instruments that a choice adds."""
    return {n for name in OF_INSTRUMENTS for n in mechanism.effects.get(name, ())}


def nominal_machine(mechanism: Mechanism, moved: Collection[str] = ()) -> Mechanism:
    """Fix all parameters but those of placements, mountings and unstated lenses.

    Placements and mountings get default priors.

    moved: parameters of what slipped during the run, which is no fault of the drawing's.
    """
    placed = {*mechanism.parameters.of_role("placement", "mounting"), *moved}
    placed |= instruments_alone(mechanism)  # no fault of the drawing's
    placed |= unstated_lenses(mechanism)
    fixed = [p.name for p in mechanism.parameters if p.name not in placed]
    made = mounted(mechanism)
    return made.with_parameters(made.parameters.with_fixed(fixed))
