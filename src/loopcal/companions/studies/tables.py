"""What the draws of a study say: the distribution of every error, by scenario and method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopcal.arrays import Array
from loopcal.companions.studies.draws import SIGMAS, seed_of
from loopcal.companions.studies.study_file import Scenario, Study

Columns = Mapping[str, Sequence[str] | Array]
END_POINT = "end point"
TELLING, LOWEST, HIGHEST = 1000, 0.1, 99.9
"""Draws from which it can be decided whether a printed one lies outside these percentiles."""


@dataclass(frozen=True)
class Placed:
    """A printed error [SI] in a distribution: percentile, and distance from the mean in its sds.

    outside: whether it lies outside 0.1 to 99.9 %, None where the draws are too few to tell.
    """

    error: float
    percentile: float
    sds: float | None
    outside: bool | None

    @classmethod
    def of(cls, error: float, errors: Array) -> Placed:
        """Where this error stands among those of the draws."""
        below, equal = np.sum(errors < error), np.sum(errors == error)
        # Ties count half, so a printed error equal to all draws is their median.
        percentile = float(100.0 * (below + 0.5 * equal) / len(errors))
        sd = float(np.std(errors, ddof=1)) if len(errors) > 1 else 0.0
        outside = percentile < LOWEST or percentile > HIGHEST
        return cls(
            error,
            percentile,
            (error - float(errors.mean())) / sd if sd > 0.0 else None,
            outside if len(errors) >= TELLING else None,
        )


@dataclass(frozen=True)
class Spread:
    """The distribution of one error [SI], true minus estimate, over the draws that converged.

    bias: its mean; sd: about the mean, None for fewer than two draws; rms; low, high: 2.5 and
    97.5 % quantiles; held: share of draws whose stated 95 % interval holds the truth. For the
    end point, of the rms distance in a draw; held then is the share of predicted coordinates.
    """

    name: str
    unit: str
    bias: float
    sd: float | None
    rms: float
    low: float
    high: float
    held: float
    published: Placed | None = None

    @classmethod
    def of(cls, name: str, unit: str, errors: Array, held: float) -> Spread:
        """The distribution of these errors."""
        low, high = np.quantile(errors, (0.025, 0.975))
        return cls(
            name,
            unit,
            float(errors.mean()),
            float(np.std(errors, ddof=1)) if len(errors) > 1 else None,
            float(np.sqrt(np.mean(np.square(errors)))),
            float(low),
            float(high),
            held,
        )


@dataclass(frozen=True)
class MethodTable:
    """What one method made of a scenario.

    failures: reason -> number of draws that did not converge, which are in no distribution;
    other_optimum: converged draws whose fit ended elsewhere than one begun at the truth.
    """

    method: str
    draws: int
    failures: Mapping[str, int]
    other_optimum: int
    spreads: tuple[Spread, ...]


@dataclass(frozen=True)
class ScenarioTable:
    """One scenario: every method, and the first method against each other one, draw by draw."""

    scenario: str
    poses: int
    methods: tuple[MethodTable, ...]
    paired: tuple[Paired, ...]


@dataclass(frozen=True)
class StudyTables:
    """All tables of a study."""

    title: str
    seed: int
    draws: int
    scenarios: tuple[ScenarioTable, ...]


def tables(study: Study, draws: int, columns: Columns) -> StudyTables:
    """The tables of all draws, the rows of `columns` being as `run_draws` gives them."""
    names = np.array(columns["scenario"])
    made = []
    for scenario in study.scenarios:
        rows = names == scenario.name
        scenario_columns: Columns = {
            name: np.asarray(values)[rows] for name, values in columns.items() if name != "scenario"
        }
        made.append(_scenario(study, scenario, scenario_columns))
    return StudyTables(study.title, study.seed, draws, tuple(made))


def _scenario(study: Study, scenario: Scenario, columns: Columns) -> ScenarioTable:
    which = np.array(columns["method"])
    of_method: dict[str, dict[str, Array]] = {
        method.name: {
            name: np.asarray(values)[which == method.name]
            for name, values in columns.items()
            if name != "method"
        }
        for method in scenario.methods
    }
    units = _units(scenario)
    first, *others = study.methods
    return ScenarioTable(
        scenario.name,
        scenario.simulation.poses,
        tuple(
            _method(scenario, name, units, method_columns)
            for name, method_columns in of_method.items()
        ),
        tuple(
            paired(
                (first, other),
                tuple(units),
                (_errors(of_method[first], units), _errors(of_method[other], units)),
                seed=seed_of(study.seed, scenario.name, f"{first} and {other}"),
            )
            for other in others
        ),
    )


def _units(scenario: Scenario) -> dict[str, str]:
    """SI units of the estimated parameters, and of the end point where there is one."""
    mechanism = scenario.mechanism
    units = {name: mechanism.parameters[name].unit for name in scenario.estimated}
    ends = {mechanism.quantities[name] for name in mechanism.outputs}
    return units | ({END_POINT: ends.pop()} if len(ends) == 1 else {})


def _errors(method_columns: Mapping[str, Array], units: Mapping[str, str]) -> Array:
    """(draws, names), NaN where the fit did not converge."""
    return np.column_stack([method_columns[_column(name)].astype(float) for name in units])


def _column(name: str) -> str:
    return "end_point_rms" if name == END_POINT else f"error.{name}"


def _method(
    scenario: Scenario, name: str, units: Mapping[str, str], columns: Mapping[str, Array]
) -> MethodTable:
    good = columns["converged"].astype(float) == 1.0
    reasons = [str(reason) for reason in columns["reason"][~good]]
    published = scenario.published.get(name, {})
    spreads = []
    for parameter, unit in units.items():
        errors = columns[_column(parameter)].astype(float)
        finite = good & np.isfinite(errors)
        if not finite.any():
            continue  # nothing converged, or no end point can be predicted
        errors = errors[finite]
        if parameter == END_POINT:
            held = float(columns["end_point_held"][finite].astype(float).mean())
        else:
            sd = columns[f"sd.{parameter}"][finite].astype(float)
            held = float(np.mean(np.abs(errors) <= SIGMAS * sd))
        spread = Spread.of(parameter, unit, errors, held)
        if parameter in published:
            spread = replace(spread, published=Placed.of(published[parameter], errors))
        spreads.append(spread)
    return MethodTable(
        name,
        len(good),
        {reason: reasons.count(reason) for reason in sorted(set(reasons))},
        int(np.nansum(columns["other_optimum"].astype(float))),
        tuple(spreads),
    )


# Two methods on the same draws: how often one is closer, and the ratio of their rms errors.


# 25 resamples beyond each quantile of 2.5 %; Efron and Tibshirani (1993) use 1000 for intervals.
RESAMPLES = 1000
LEVEL = 0.95


@dataclass(frozen=True)
class Advantage:
    """One error of two methods on the same draws.

    closer: share of draws in which the first method's is the smaller, ties counting half to
    either, with its exact binomial 95 % interval (Clopper and Pearson 1934); ratio: rms error of
    the first over that of the second, with its 95 % bootstrap interval over draws (Efron 1979);
    None where the second makes no error.
    """

    name: str
    closer: float
    closer_low: float
    closer_high: float
    ratio: float | None
    ratio_low: float | None
    ratio_high: float | None


@dataclass(frozen=True)
class Paired:
    """The first method against the second over the draws in which both converged."""

    methods: tuple[str, str]
    draws: int
    advantages: tuple[Advantage, ...]


def paired(
    methods: tuple[str, str], names: tuple[str, ...], errors: tuple[Array, Array], *, seed: int
) -> Paired:
    """Compare two methods draw by draw.

    errors: of each, (draws, names) [SI], NaN where a fit did not converge; seed: of the resampling.
    """
    both = np.isfinite(errors[0]).all(axis=1) & np.isfinite(errors[1]).all(axis=1)
    first, second = (np.abs(e[both]) for e in errors)
    draws = len(first)
    if not draws:
        return Paired(methods, 0, ())
    wins = np.sum(first < second, axis=0) + 0.5 * np.sum(first == second, axis=0)
    squares = np.column_stack([np.square(first), np.square(second)])
    ratios = _ratio(squares.mean(axis=0))
    low, high = _bootstrap(squares, seed)
    advantages = []
    for i, name in enumerate(names):
        closer_low, closer_high = binomial_interval(float(wins[i]), draws)
        finite = bool(np.isfinite(ratios[i]) and np.isfinite(low[i]) and np.isfinite(high[i]))
        advantages.append(
            Advantage(
                name,
                float(wins[i]) / draws,
                closer_low,
                closer_high,
                float(ratios[i]) if finite else None,
                float(low[i]) if finite else None,
                float(high[i]) if finite else None,
            )
        )
    return Paired(methods, draws, tuple(advantages))


def binomial_interval(wins: float, draws: int) -> tuple[float, float]:
    """The exact interval of the probability of a win (Clopper-Pearson).

    >>> [round(end, 3) for end in binomial_interval(970, 1000)]
    [0.957, 0.98]
    """
    from scipy.special import betaincinv

    tail = (1.0 - LEVEL) / 2.0
    low = betaincinv(wins, draws - wins + 1.0, tail) if wins > 0 else 0.0
    high = betaincinv(wins + 1.0, draws - wins, 1.0 - tail) if wins < draws else 1.0
    return float(low), float(high)


def _ratio(mean_squares: Array) -> Array:
    half = mean_squares.shape[-1] // 2
    first, second = mean_squares[..., :half], mean_squares[..., half:]
    safe = np.where(second > 0.0, second, 1.0)
    return np.asarray(np.where(second > 0.0, np.sqrt(first / safe), np.nan), dtype=np.float64)


def _bootstrap(squares: Array, seed: int) -> tuple[Array, Array]:
    """Quantiles (c,) of the ratios of rms errors over resampled draws."""
    rng = np.random.Generator(np.random.PCG64(seed))
    draws = len(squares)
    ratios = []
    for _ in range(RESAMPLES):
        # A resample is how often each draw is taken; its means follow from one product.
        counts = np.bincount(rng.integers(0, draws, draws), minlength=draws)
        ratios.append(_ratio(counts @ squares / draws))
    tail = (1.0 - LEVEL) / 2.0
    low, high = np.quantile(np.array(ratios), (tail, 1.0 - tail), axis=0)
    return low, high
