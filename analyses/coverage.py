"""Do the stated uncertainties hold? Coverage of 95 % intervals, and chi-squared p-values.

Simulated calibrations with known truth: planar and six-axis arm, three noise levels, flat priors
(truth fixed) and proper ones (truth drawn from the prior). Each case counts how often the 95 %
interval of a parameter, and of a predicted end-point coordinate, holds the truth, whether the
p-values of chi-squared are uniform (Kolmogorov-Smirnov), and how often a gear error of 0.2 mm
is seen. Beside a coverage pooled over parameters or coordinates stands its Monte Carlo standard
error: intervals of one draw share its errors, so a draw counts once, by the share it held.

    python -m analyses.coverage [--draws 2000] [--first 0] [--processes 2] [--only WORD ...]

`--only planar low` runs the cases named by all these words, `--first` draws others than before.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import pairwise, repeat

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kstest

import loopcal as lc
from loopcal.estimation.prediction import predict_outputs
from loopcal.estimation.sensitivity import output_sensitivity

Array = NDArray[np.float64]
SIGMAS = 1.959963984540054
JOINTS = {"planar": (-np.pi, np.pi), "six-axis": (-1.4, 1.4)}
LEVELS = {"low": 0.1, "base": 1.0, "high": 10.0}


@dataclass(frozen=True)
class Case:
    """One machine at one noise level; proper: finite prior sds, truth drawn from them."""

    machine: str
    level: str
    proper: bool

    def __str__(self) -> str:
        return f"{self.machine:9} {self.level:5} {'proper' if self.proper else 'flat':6}"


@dataclass(frozen=True)
class Counts:
    """What some draws found; held, points: 1 where an interval held the truth, one row a draw."""

    held: Array
    points: Array
    p_values: Array


def standard_error(held: Array) -> float:
    """Monte Carlo standard error of the pooled coverage held.mean(), shape (draws, intervals)."""
    return float(held.mean(axis=1).std(ddof=1) / np.sqrt(len(held)))


def nominal(machine: str) -> lc.Mechanism:
    if machine == "planar":
        return lc.planar_two_link()
    return lc.motoman_ma1400({"z1": 0.45, "x6B": 0.05, "z6B": -0.45})


def sds_of(mechanism: lc.Mechanism, level: float) -> dict[str, float]:
    base = {"m": 1e-4, "rad": 1e-3} if len(mechanism.outputs) == 2 else {"m": 1e-5, "rad": 5e-5}
    return {q: level * base[unit] for q, unit in mechanism.quantities.items()}


def joints(mechanism: lc.Mechanism, machine: str, poses: int, seed: int) -> dict[str, Array]:
    driven = [q for q in mechanism.quantities if q not in mechanism.outputs]
    return lc.random_poses(dict.fromkeys(driven, JOINTS[machine]), poses, seed=seed)


def run(case: Case, seeds: range) -> Counts:
    start = nominal(case.machine)
    sds = sds_of(start, LEVELS[case.level])
    names = start.parameters.names
    prior_sds = {
        p.name: (0.3 if i % 2 else 3.0) * LEVELS[case.level] * 1e-4
        for i, p in enumerate(start.parameters)
    }
    prior = lc.Prior(prior_sds if case.proper else {"*": np.inf})
    poses = joints(start, case.machine, 60, seed=1)
    elsewhere = lc.Dataset.from_arrays(joints(start, case.machine, 5, seed=2))
    held, points, p_values = [], [], []
    apart = 100_000 * list(LEVELS).index(case.level)  # levels are independent draws, not one scaled
    for seed in (apart + s for s in seeds):
        truth = {p.name: p.nominal for p in start.parameters}
        if case.proper:
            z = np.random.default_rng([7, seed]).standard_normal(len(names))
            truth = {n: truth[n] + prior_sds[n] * v for n, v in zip(names, z, strict=True)}
        made = lc.simulate(start, poses, noise=lc.Noise(sds), seed=seed, truth=truth)
        found = lc.calibrate(
            start,
            made.dataset,
            noise=lc.Noise(sds),
            prior=prior,
            start="nominal",
            method="implicit-loop",
        )
        assert found.status.converged
        held.append(
            [abs(found.value[n] - truth[n]) <= SIGMAS * (found.sd[n] or 0.0) for n in names]
        )
        points.append(_points_held(found, truth, elsewhere).ravel())
        p_values.append(_p_value(found))
    return Counts(1.0 * np.array(held), np.array(points), np.array(p_values))


def _points_held(found: lc.Result, truth: dict[str, float], at: lc.Dataset) -> Array:
    mechanism = found.mechanism
    empty, none = np.zeros(len(at)), np.zeros((0, len(at)))
    x = np.array([at.readings.get(q, empty) for q in mechanism.quantities])
    names = mechanism.parameters.names
    p, true = (np.array([v[n] for n in names]) for v in (found.value, truth))
    y, y_true = (predict_outputs(mechanism, values, x, none) for values in (p, true))
    x[[mechanism.tape.quantities.index(q) for q in mechanism.outputs]] = y
    S = output_sensitivity(mechanism, p, found.estimated, x, none).by_parameter
    variance = np.einsum("noi,ij,noj->on", S, found.covariance, S)
    held: Array = 1.0 * (np.abs(y - y_true) <= SIGMAS * np.sqrt(variance))
    return held


def gear_error_p(seed: int, sd: float = 1e-5, error: float = 2e-4) -> float:
    """p-value of a six-axis fit whose first gear moves the end point by up to `error` [m]."""
    arm = nominal("six-axis")
    sds = dict.fromkeys(arm.quantities, sd)
    poses = joints(arm, "six-axis", 60, seed=1)
    first = next(q for q in arm.quantities if q not in arm.outputs)
    made = lc.simulate(arm, poses, noise=lc.Noise(sds), seed=seed)
    reach = np.hypot(made.quantities["x"], made.quantities["y"]).max()  # lever of the first joint
    wrong = made.dataset[first] + error / reach * np.sin(7 * made.quantities[first])
    data = made.dataset.with_readings({first: wrong})
    return _p_value(
        lc.calibrate(arm, data, noise=lc.Noise(sds), start="nominal", method="implicit-loop")
    )


def _p_value(found: lc.Result) -> float:
    assert found.chi_squared is not None
    assert found.chi_squared.p_value is not None
    return found.chi_squared.p_value


def _parts(first: int, draws: int, processes: int) -> list[range]:
    edges = np.linspace(first, first + draws, processes + 1).astype(int)
    return [range(a, b) for a, b in pairwise(edges)]


def _line(case: Case, parts: list[Counts]) -> str:
    held, points = (
        100 * np.concatenate([getattr(c, n) for c in parts]) for n in ("held", "points")
    )
    single = held.mean(axis=0)
    ks = kstest(np.concatenate([c.p_values for c in parts]), "uniform").pvalue
    return (
        f"{case}  {held.mean():6.2f} +- {standard_error(held):.2f}"
        f"   {single.min():6.2f} {single.max():6.2f}"
        f"   {points.mean():6.2f} +- {standard_error(points):.2f}  {ks:10.3f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--only", nargs="+", default=[])
    given = parser.parse_args()
    draws, first = given.draws, given.first
    cases = [Case(m, v, proper) for m in JOINTS for v in LEVELS for proper in (False, True)]
    single = 100 * np.sqrt(0.95 * 0.05 / draws)
    print(f"{draws} draws; coverage of 95 % intervals [%], +- its Monte Carlo standard error")
    print(f"standard error of one parameter's coverage: {single:.2f}")
    print("machine   noise prior   parameters      least   most   end points    p uniform (KS)")
    with ProcessPoolExecutor(given.processes) as pool:
        for case in (c for c in cases if {*given.only} <= {*str(c).split()}):
            parts = list(pool.map(run, repeat(case), _parts(first, draws, given.processes)))
            print(_line(case, parts), flush=True)
        if not given.only:
            seeds = range(first, first + draws)
            p = np.array(list(pool.map(gear_error_p, seeds, chunksize=50)))
            print(
                f"gear error of 0.2 mm at 10 um: rejected at 5 % in {100 * np.mean(p < 0.05):.1f} %"
            )


if __name__ == "__main__":
    main()
