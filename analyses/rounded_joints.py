"""Joints rounded to 0.1 degrees taken as normal with sd 0.1 / sqrt(12): are the answers right?

The ABB IRB 120 of examples/irb120/wire.toml, 120 lengths of a draw-wire. Its parameters are drawn
from their priors, and the true joints are read three ways: with normal noise of that sd, rounded,
and rounded where the joints behind the second take eight positions only, as in the measured file:
then fifteen poses share one error of rounding. Coverage of 95 % intervals, and chi-squared.

    python -m analyses.rounded_joints [--draws 200] [--processes 2]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kstest

import loopcal as lc

Array = NDArray[np.float64]
PROJECT = Path(__file__).parents[1] / "examples" / "irb120" / "wire.toml"
STEP = math.radians(0.1)
SIGMAS = 1.959963984540054
WIRE = 0.2e-3
WAYS = ("normal", "rounded", "rounded in runs")
SPANS = {
    "q1": (-89, -51),
    "q2": (6, 40),
    "q3": (-31, -3),
    "q4": (-15.6, -14.2),
    "q5": (73, 80.5),
    "q6": (-60, -51),
}
"""Ranges of the joints of the measured file [deg]."""
POSES, RUNS = 120, 8


def joints(way: str, rng: np.random.Generator) -> dict[str, Array]:
    """True joint angles [rad]."""
    found = {}
    for i, (name, span) in enumerate(SPANS.items()):
        low, high = np.radians(span)
        values = rng.uniform(low, high, POSES)
        if way == "rounded in runs" and i > 1:
            values = np.repeat(values[:RUNS], POSES // RUNS)
        found[name] = values
    return found


def run(way: str, seeds: Sequence[int]) -> Array:
    """Of each draw: share of intervals that held, chi-squared over freedom, its p-value."""
    machine = lc.read_project(PROJECT).mechanism
    machine = machine.with_parameters(machine.parameters.with_prior({"wire_*": 0.05}))
    noise = lc.Noise({"q?": STEP / math.sqrt(12), "L": WIRE})
    rows = []
    for seed in seeds:
        rng = np.random.default_rng([WAYS.index(way), int(seed)])
        truth = {
            p.name: p.nominal + (0.0 if p.fixed else rng.normal(0.0, p.prior_sd))
            for p in machine.parameters
        }
        made = lc.simulate(
            machine, joints(way, rng), noise=lc.Noise({"q?": 0.0, "L": WIRE}), seed=int(seed),
            truth=truth,
        )  # fmt: skip
        read = {
            q: v + rng.normal(0.0, STEP / math.sqrt(12), POSES)
            if way == "normal"
            else STEP * np.round(v / STEP)
            for q, v in made.quantities.items()
            if q != "L"
        }
        data = made.dataset.with_readings(read)
        found = lc.calibrate(machine, data, noise=noise, start="nominal", method="implicit-loop")
        assert found.chi_squared is not None
        held = [
            abs(found.value[n] - truth[n]) <= SIGMAS * (found.sd[n] or 0.0) for n in found.estimated
        ]
        chi = found.chi_squared
        rows.append([float(np.mean(held)), chi.variance_factor or 0.0, chi.p_value or 0.0])
    return np.array(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    print(f"{given.draws} draws; +- is the Monte Carlo standard error")
    print("joints            coverage [%]      chi-squared / freedom   p uniform")
    with ProcessPoolExecutor(given.processes) as pool:
        for way in WAYS:
            parts = np.array_split(np.arange(given.draws), 4 * given.processes)
            rows = np.concatenate(list(pool.map(run, repeat(way), parts)))
            mean, error = rows.mean(axis=0), rows.std(axis=0, ddof=1) / math.sqrt(len(rows))
            uniform = kstest(rows[:, 2], "uniform").pvalue
            print(
                f"{way:16}  {100 * mean[0]:.2f} +- {100 * error[0]:.2f}     "
                f"{mean[1]:.4f} +- {error[1]:.4f}        {uniform:.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
