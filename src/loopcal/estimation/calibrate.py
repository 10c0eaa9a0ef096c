"""Calibration: a mechanism, its readings and what is known of their noise, to a result."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, nearest
from loopcal.estimation.distances import distances
from loopcal.estimation.noise.discrepancy import model_discrepancy
from loopcal.estimation.noise.estimation import NoiseEstimate, estimate_noise
from loopcal.estimation.noise.learning import components, entries, with_model, words
from loopcal.estimation.prediction import output_differences
from loopcal.estimation.problem.alignment import begins_aligned, placed
from loopcal.estimation.problem.problem import Problem, build_problem
from loopcal.estimation.problem.unreachable import refuse_unreachable
from loopcal.estimation.result import (
    Accuracy,
    ChiSquared,
    Identifiability,
    Result,
    Undetermined,
    frozen,
)
from loopcal.estimation.solve.loss import loss_named
from loopcal.estimation.solve.reduction import spectrum, undetermined
from loopcal.estimation.solve.reweighted import solve_reweighted
from loopcal.estimation.solve.robust import robust_covariance, solve_robust
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.estimation.solve.seed_iteration import iterate_undamped
from loopcal.estimation.solve.solver import Progress, Solution, solve
from loopcal.estimation.solve.sweep import Sweeper
from loopcal.expressions.engine import Stage
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.noise import Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.prior import Prior

Array = NDArray[np.float64]
METHODS = ("implicit-loop", "least-squares", "reweighted", "implicit-loop-undamped")
STARTS = ("auto", "align", "nominal")


def calibrate(
    mechanism: Mechanism,
    data: Dataset | Any,
    *,
    noise: Noise | None = None,
    prior: Prior | None = None,
    method: str = "implicit-loop",
    loss: str = "gaussian",
    start: str | Mapping[str, float] = "auto",
    max_iterations: int = 100,
    progress: Progress | None = None,
) -> Result:
    """Calibrate a mechanism from readings.

    method "implicit-loop" finds the parameters of maximum likelihood while every loop closes:
    minimise sum_i c_i^T Sigma^-1 c_i + (p - nominal)^T Sigma_p^-1 (p - nominal) over parameters
    p and corrections c_i subject to f(reading_i + c_i, p) = 0 (Wampler, Hollerbach and Arai
    1995; seed 3.7 to 3.30). "least-squares" takes the readings as exact and minimises the sum
    of squared loop values (seed 3.1 to 3.6), without noise or prior. "reweighted"
    weighs the readings as they are by their propagated noise J_x Sigma J_x^T, without letting
    that noise say anything about the parameters: the robust choice where poses are alike and sds
    guessed. "implicit-loop-undamped" is the seed's own iteration, for study.

    loss: "huber" or "student-t" let poses that do not fit count less
    (`loopcal.estimation.solve.loss`);
    the covariance is then valid without normal errors, and there is no chi-squared. For the
    methods "implicit-loop" and "reweighted" with stated sds.

    start: "nominal"; "align" moves the nominal machine rigidly to where the instrument sees it;
    "auto" aligns a machine whose placement parameters are free with flat priors; or
    parameter values [SI] by name. Angles rad, lengths m throughout.

    data: a Dataset, or a dict of (N,) arrays or any DataFrame of readings in SI units.

    Raises InputError for input that cannot be used; a fit that does not converge is returned,
    with its status saying so.
    """
    if method not in METHODS:
        raise InputError(f"there is no method {method!r}", remedy=nearest(method, METHODS))
    if noise is None and method != "least-squares":
        raise InputError(
            f"the method {method!r} needs to know how uncertain the readings are",
            remedy="give noise=Noise({...}) with an sd for every quantity, "
            'or use method="least-squares"',
        )
    _check_loss(loss, method, noise)
    if not isinstance(data, Dataset):
        data = Dataset.from_arrays(data)
    if prior is not None:
        mechanism = mechanism.with_parameters(prior.apply(mechanism.parameters))
    exact = method == "least-squares"
    if noise is not None and not exact:
        mechanism, data = with_model(mechanism, data, noise)
    with one_blas_thread():
        problem = _started(mechanism, data, None if exact else noise, start)

        chosen = loss_named(loss)
        if chosen is not None:
            robust = solve_robust(
                problem,
                chosen,
                reweighted=method == "reweighted",
                max_iterations=max_iterations,
                progress=progress,
            )
            return result_of(method, problem, robust, data, loss=loss)

        def fit(problem: Problem) -> Solution:
            if method == "implicit-loop-undamped":
                return iterate_undamped(problem, max_iterations=max_iterations)
            if method == "reweighted":
                return solve_reweighted(problem, max_iterations=max_iterations, progress=progress)
            return solve(problem, exact=exact, max_iterations=max_iterations, progress=progress)

        if exact or noise is None or not noise.estimate:
            return result_of(method, problem, fit(problem), data)
        estimate = estimate_noise(
            problem, components(problem, noise), fit, at_readings=method == "reweighted"
        )
        learnt = replace(estimate.problem, start=problem.start)
        return result_of(method, learnt, estimate.solution, data, problem, estimate)


def _check_loss(loss: str, method: str, noise: Noise | None) -> None:
    if loss_named(loss) is None:
        return
    if method not in ("implicit-loop", "reweighted"):
        raise InputError(
            f"the loss {loss!r} needs to know how far off a pose may be, which the method "
            f"{method!r} does not",
            remedy='use method = "implicit-loop" or "reweighted" with the sds of the readings',
        )
    if noise is not None and noise.estimate:
        raise InputError(
            f"sds cannot be estimated under the loss {loss!r}: how bad readings scatter would "
            "become part of them",
            remedy="find the outliers with this loss first and exclude them, then estimate; or "
            'take the sds as given (leave out "estimate")',
        )


def _started(
    mechanism: Mechanism, data: Dataset, noise: Noise | None, start: str | Mapping[str, float]
) -> Problem:
    if not isinstance(start, str):
        for name in start:
            mechanism.parameters[name]  # raises for a name that is not there
        return build_problem(mechanism, data, noise, start)
    if start not in STARTS:
        raise InputError(f"there is no start {start!r}", remedy=nearest(start, STARTS))
    problem = build_problem(mechanism, data, noise)
    if begins_aligned(mechanism, start):
        moved, _ = placed(problem)
        problem = build_problem(moved, data, noise)
    refuse_unreachable(problem, problem.start)
    return problem


def result_of(
    method: str,
    problem: Problem,
    solution: Solution,
    data: Dataset,
    stated: Problem | None = None,
    estimate: NoiseEstimate | None = None,
    loss: str = "gaussian",
    alike: bool = True,
) -> Result:
    """The result of a fit; alike: whether its poses misfit as all do, so that one error of the
    model may explain it."""
    mechanism, exact = problem.mechanism, method == "least-squares"
    robust = loss_named(loss)
    names = mechanism.parameters.names
    system = solution.spectrum
    finite = 0 if exact else int(np.isfinite(problem.prior_sd).sum())
    freedom = problem.equations + finite - system.rank
    merit = solution.chi_squared
    covariance = system.covariance()
    if exact:
        covariance = covariance * (merit / freedom if freedom > 0 else math.inf)
    if robust is not None:
        covariance = robust_covariance(problem, solution, robust, reweighted=method == "reweighted")
    identifiability = _identifiability(problem, solution)
    loose = {n for u in identifiability.not_identifiable for n in u.combination}
    sd: dict[str, float | None] = dict.fromkeys(names)
    for i, name in enumerate(problem.names):
        sd[name] = math.inf if name in loose else math.sqrt(max(float(covariance[i, i]), 0.0))
    chi = None
    if not exact and robust is None and math.isfinite(merit):
        chi = ChiSquared(merit, freedom, _p_value(merit, freedom), _ratio(merit, freedom))
    quantities = mechanism.tape.quantities
    corrections = solution.corrections
    sds = np.broadcast_to(problem.uncertainty.sd, corrections.shape)
    differences = (
        _differences(problem, problem.start),
        _differences(problem, solution.parameters, corrections),
    )
    result = Result(
        method=method,
        status=solution.status,
        mechanism=mechanism,
        value=MappingProxyType(dict(zip(names, map(float, solution.parameters), strict=True))),
        sd=MappingProxyType(sd),
        estimated=problem.names,
        covariance=covariance,
        chi_squared=chi,
        noise=() if exact else entries(problem, estimate, stated or problem),
        corrections=frozen(dict(zip(quantities, corrections, strict=True))),
        reading_sds=frozen(dict(zip(quantities, sds, strict=True))),
        residuals_before=_residuals(problem, problem.start),
        residuals_after=_residuals(problem, solution.parameters, corrections),
        differences_before=differences[0],
        differences_after=differences[1],
        accuracy_before=_accuracy(problem, differences[0]),
        accuracy_after=_accuracy(problem, differences[1]),
        identifiability=identifiability,
        dataset=data,
        problem=problem,
        spectrum=solution.spectrum,
        information=solution.data,
        loss=loss,
    )
    if result.status.converged and alike and _too_small_sds(result):
        result = replace(result, model_discrepancy=model_discrepancy(problem, solution))
    learnt = () if estimate is None else words(estimate, result.noise, result.chi_squared_shares)
    return replace(
        result,
        warnings=_warnings(result) + learnt,
        restricted_criterion=None if estimate is None else estimate.criterion,
    )


def _too_small_sds(result: Result) -> bool:
    """Whether chi-squared says that corrections are larger than the stated sds allow."""
    chi = result.chi_squared
    if chi is None or chi.p_value is None or chi.variance_factor is None:
        return False
    return chi.p_value < 1e-3 and chi.variance_factor > 1.0


def _p_value(chi_squared: float, freedom: int) -> float | None:
    from scipy.special import chdtrc

    return float(chdtrc(freedom, chi_squared)) if freedom > 0 else None


def _ratio(chi_squared: float, freedom: int) -> float | None:
    return chi_squared / freedom if freedom > 0 else None


def _identifiability(problem: Problem, solution: Solution) -> Identifiability:
    system = solution.spectrum
    alone = system
    if np.isfinite(problem.prior_sd).any():
        flat = np.full(len(problem.free), np.inf)
        alone = spectrum(solution.data, np.zeros(len(problem.free)), flat)
    directions = undetermined(system, problem.names)
    condition = system.condition
    return Identifiability(
        system.rank,
        len(problem.free),
        alone.rank,
        condition if system.rank == len(problem.free) and math.isfinite(condition) else None,
        tuple(Undetermined(MappingProxyType(c), _in_words(c)) for c in directions),
    )


def _in_words(combination: Mapping[str, float]) -> str:
    names = [repr(name) for name in combination]
    if len(names) == 1:
        return f"{names[0]} has no effect that these poses could show"
    listed = ", ".join(names[:-1]) + f" and {names[-1]}"
    return f"{listed} cannot be told apart by these poses"


def _residuals(
    problem: Problem, parameters: Array, corrections: Array | None = None
) -> Mapping[str, Array]:
    """Loop values with these corrections, NaN where a loop does not hold.

    Unmeasured quantities stay where the fit left them.
    """
    loops = problem.mechanism.tape.loops
    out = np.full((len(loops), len(problem.poses)), np.nan)
    sweeper = Sweeper(problem)
    sweeper.at(parameters)
    for pattern, poses in problem.blocks():
        x = problem.readings[:, poses]
        if corrections is not None:
            x = x + corrections[:, poses]
        values = sweeper.engine(pattern).evaluate(x, problem.known[:, poses], Stage.VALUES).f
        for row, loop in enumerate(pattern.loops):
            out[loop, poses] = values[row]
    return frozen(dict(zip(loops, out, strict=True)))


def _differences(
    problem: Problem, parameters: Array, corrections: Array | None = None
) -> Mapping[str, Array]:
    """Computed minus measured outputs; quantities that no sensor reads come from the loops."""
    outputs = problem.mechanism.outputs
    if not outputs:
        return {}
    found = output_differences(problem, parameters, corrections)
    return frozen(dict(zip(outputs, found, strict=True)))


def _accuracy(problem: Problem, differences: Mapping[str, Array]) -> Accuracy | None:
    mechanism = problem.mechanism
    rows = [mechanism.tape.quantities.index(q) for q in mechanism.outputs]
    found = distances(mechanism, problem.readings[rows], np.array(list(differences.values())))
    return None if found is None else Accuracy.of(found.values, found.unit)


def _warnings(result: Result) -> tuple[str, ...]:
    words = []
    for loose in result.identifiability.not_identifiable:
        words.append(
            f"Not identifiable: {loose.words}. The fit moves along such a direction as little as "
            "it can; fix a parameter, give it a prior sd, or measure other poses."
        )
    if result.mechanism.placement is not None:
        words += result.mechanism.placement.advice(result.value)
    chi = result.chi_squared
    if chi is not None and _too_small_sds(result):
        words.append(_too_large(chi, result.model_discrepancy, result))
    elif chi is not None and (chi.p_value or 0.0) > 0.999 and (chi.variance_factor or 1.0) < 0.8:
        words.append(
            f"Chi-squared per degree of freedom is {chi.variance_factor:.2g}: the readings "
            "scatter less than their stated sds, which are too large."
        )
    return tuple(words)


def _too_large(chi: ChiSquared, discrepancy: float | None, result: Result) -> str:
    assert chi.variance_factor is not None
    factor = chi.variance_factor
    text = f"{factor:.0f}" if factor >= 10 else f"{factor:.2g}"
    times = math.sqrt(factor)
    explained = ""
    if discrepancy:
        unit = result.mechanism.quantities[result.mechanism.outputs[0]]
        explained = (
            f" Besides the sensors as stated, an error of about {discrepancy:.2g} {unit} in each "
            "coordinate of the end point would explain it."
        )
    return (
        f"Chi-squared per degree of freedom is {text}: the corrections are about {times:.2g} times "
        "as large as the stated sds allow, so these sds cannot be right. Either the sensors are "
        f"worse than stated, or the machine model lacks something real (a model error).{explained} "
        "The sd of "
        "every parameter below is too small in that case, and a closed loop is no sign of "
        "accuracy: compare the accuracy lines instead."
    )
