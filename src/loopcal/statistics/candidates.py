"""The candidates of a choice: the methods, with a model error and without, and the drawing."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

from loopcal.estimation.methods import implicit_loop
from loopcal.estimation.model_error import instrument_noise, modelled
from loopcal.estimation.nominal import nominal_machine
from loopcal.estimation.problem.weighting import Weighting
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.statistics.case import Case

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
    if made is None:
        made = modelled(with_error, machine, len(case.data)) if lossless else machine
    for method in methods if len(made.terms) > len(machine.terms) else ():
        if method.weighting is Weighting.READ:
            continue  # the noise of the model error says nothing about the parameters anyway
        # the mechanism has the prior already
        error_fit = with_error.changed(method=method, prior=None)
        name = f"{method.name} with model error"
        yield Entrant(name, replace(case, mechanism=made, fit=error_fit), True)
    for method in methods:
        plain = fit.changed(method=method, model_error="none")
        yield Entrant(method.name, replace(case, fit=plain))
    if case.mechanism.outputs:
        drawn = nominal_case(case, moved)
        if (
            drawn.mechanism.parameters.free
        ):  # else the accuracy before the fit is that of the drawing
            yield Entrant(NOMINAL, drawn, drawn=True)


def nominal_case(case: Case, moved: Collection[str] = ()) -> Case:
    """The nominal machine, placed and mounted by readings of instruments weighted alike."""
    mechanism = nominal_machine(case.fit.with_prior(case.mechanism), moved)
    noise = instrument_noise(mechanism, case.data)
    fit = case.fit.changed(
        method=implicit_loop.METHOD, loss="gaussian", prior=None, model_error="none"
    )
    return Case(mechanism, replace(case.data, sds={}), noise, fit)
