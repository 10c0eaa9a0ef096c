"""Do parallel machines calibrate? Truth recovered, chi-squared, coverage of intervals, ranks.

Simulated calibrations of each machine, seen by instruments or by its own passive joints, from 60
random poses at 10 um and 50 urad, beginning about 1 mm and 1 mrad off. The platform's coordinates
are read by nobody. Each case counts how often the 95 % interval of a parameter holds the truth,
compares chi-squared with its degrees of freedom and the error of all parameters together with
their covariance; rank is what the poses determine, beside what the docs derive.

    python -m analyses.machines [--draws 500] [--processes 2] [--only WORD ...] [--write FILE]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, kstest

import loopcal as lc
from analyses.written import write_block
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.machine import Instrument, Machine, assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parallel.delta import linear_delta, rotary_delta
from loopcal.mechanisms.parallel.five_bar import five_bar
from loopcal.mechanisms.parallel.four_bar import four_bar
from loopcal.mechanisms.parallel.stewart_gough import stewart_gough
from loopcal.mechanisms.parallel.three_rrr import three_rrr
from loopcal.mechanisms.station import Target

Array = NDArray[np.float64]
Ranges = Mapping[str, tuple[float, float]]

FOUR_BAR = {"theta_1": (-3.1, 3.1)}
FIVE_BAR = {"platform_x": (0.0, 0.25), "platform_y": (0.3, 0.5)}
THREE_RRR = {"platform_x": (-0.05, 0.05), "platform_y": (-0.05, 0.05), "platform_rz": (-0.3, 0.3)}
LINEAR_DELTA = {"platform_x": (-0.07, 0.07), "platform_y": (-0.07, 0.07), "platform_z": (0.0, 0.2)}
ROTARY_DELTA = {
    "platform_x": (-0.15, 0.15),
    "platform_y": (-0.15, 0.15),
    "platform_z": (-0.5, -0.38),
}
STEWART_GOUGH = {
    "platform_x": (-0.1, 0.1),
    "platform_y": (-0.1, 0.1),
    "platform_z": (0.6, 0.8),
    "platform_rz": (-0.4, 0.4),
    "platform_ry": (-0.3, 0.3),
    "platform_rx": (-0.3, 0.3),
}
TOOL = {"tool_x": 0.06, "tool_y": 0.03, "tool_z": 0.08}
OWN = Target(())
"""The frame of the body itself."""


@dataclass(frozen=True)
class Case:
    """A machine with its instruments, where it is driven, and how many parameters it shows."""

    machine: Callable[[], Machine]
    instruments: Callable[[], list[Instrument]]
    driven: Ranges
    identifiable: int

    def made(self) -> Mechanism:
        """The mechanism, its target at a place where no joint is."""
        made = assemble(self.machine(), self.instruments())
        return made.with_nominal({n: v for n, v in TOOL.items() if n in made.parameters.free})

    def unread(self, mechanism: Mechanism) -> list[str]:
        """The platform's coordinates."""
        return [q for q in mechanism.quantities if q.startswith("platform_")]


def _planar(station: str | None = "base") -> list[Instrument]:
    return [point(readings=("x", "y"), station=station, dimension=2)]


CASES = {
    "four-bar, point": Case(four_bar, _planar, FOUR_BAR, 10),
    "four-bar, rocker read": Case(lambda: four_bar(passive=["theta_2"]), list, FOUR_BAR, 5),
    "four-bar, both read": Case(lambda: four_bar(passive=["theta_2", "phi_1"]), list, FOUR_BAR, 6),
    "five-bar, point": Case(five_bar, _planar, FIVE_BAR, 12),
    "five-bar, one elbow read": Case(lambda: five_bar(passive=["phi_1"]), list, FIVE_BAR, 7),
    "five-bar, both elbows read": Case(
        lambda: five_bar(passive=["phi_1", "phi_2"]), list, FIVE_BAR, 8
    ),
    "3-RRR, point": Case(three_rrr, _planar, THREE_RRR, 20),
    "3-RRR, pose": Case(three_rrr, lambda: [pose(dimension=2)], THREE_RRR, 21),
    "3-RRR, own pose": Case(
        three_rrr, lambda: [pose(dimension=2, station=None, target=OWN)], THREE_RRR, 21
    ),
    "3-RRR, elbows read": Case(
        lambda: three_rrr(passive=["phi_1", "phi_2", "phi_3"]), list, THREE_RRR, 17
    ),
    "linear delta, point": Case(linear_delta, lambda: [point()], LINEAR_DELTA, 18),
    "linear delta, own point": Case(linear_delta, lambda: [point(station=None)], LINEAR_DELTA, 18),
    "rotary delta, point": Case(rotary_delta, lambda: [point()], ROTARY_DELTA, 24),
    "rotary delta, own point": Case(rotary_delta, lambda: [point(station=None)], ROTARY_DELTA, 24),
    "Stewart-Gough, point": Case(stewart_gough, lambda: [point()], STEWART_GOUGH, 39),
    "Stewart-Gough, pose": Case(stewart_gough, lambda: [pose()], STEWART_GOUGH, 42),
    "Stewart-Gough, own pose": Case(
        stewart_gough, lambda: [pose(station=None, target=OWN)], STEWART_GOUGH, 42
    ),
    "Stewart-Gough, three angles": Case(
        lambda: stewart_gough(passive=["alpha_1", "beta_1", "alpha_2"]), list, STEWART_GOUGH, 37
    ),
}


POSES, SIGMAS = 60, 1.959963984540054
FAR = 1e-3
"""How far off the nominal machine is, as an sd [m, rad]."""


@dataclass(frozen=True)
class Counts:
    """Of some draws: held, 1 where an interval held the truth; factors, chi-squared by freedom;
    fits, p-values of chi-squared; errors, those of the error of all parameters; rank, freedom."""

    held: Array
    factors: Array
    fits: Array
    errors: Array
    rank: int
    freedom: int


def run(name: str, seeds: Sequence[int]) -> Counts:
    """Calibrations of a case, one for each seed, always of the same true machine."""
    case = CASES[name]
    mechanism = case.made()
    draw = np.random.default_rng(1)
    free = mechanism.parameters.free
    truth = {n: mechanism.parameters[n].nominal + FAR * draw.standard_normal() for n in free}
    sds = {q: 1e-5 if unit == "m" else 5e-5 for q, unit in mechanism.quantities.items()}
    noise = lc.Noise(sds | dict.fromkeys(case.unread(mechanism), np.inf))
    poses = lc.random_poses(case.driven, POSES, seed=2)
    held, factors, fits, errors, rank, freedom = [], [], [], [], 0, 0
    for seed in seeds:
        made = lc.simulate(mechanism, poses, noise=noise, seed=seed, truth=truth)
        found = lc.calibrate(mechanism, made.dataset, noise=noise, method="implicit-loop")
        chi = found.chi_squared
        assert found.status.converged, (name, seed, found.status)
        assert chi is not None
        assert chi.p_value is not None
        error = np.array([truth[n] - found.value[n] for n in found.estimated])
        sd = np.sqrt(np.diag(found.covariance))
        held.append(np.abs(error) <= SIGMAS * sd)
        factors.append(chi.value / chi.degrees_of_freedom)
        fits.append(chi.p_value)
        shape = found.covariance / np.outer(sd, sd)
        errors.append(chi2.sf((error / sd) @ np.linalg.solve(shape, error / sd), len(error)))
        rank, freedom = found.identifiability.rank, chi.degrees_of_freedom
    return Counts(
        np.array(held, float), np.array(factors), np.array(fits), np.array(errors), rank, freedom
    )


def line(name: str, parts: Sequence[Counts]) -> str:
    """One row of the table."""
    held, factors, fits, errors = (
        np.concatenate([getattr(c, key) for c in parts])
        for key in ("held", "factors", "fits", "errors")
    )
    draws = np.sqrt(len(held))
    spread, mean = held.mean(axis=1).std(ddof=1) / draws, factors.std(ddof=1) / draws
    single = 100 * held.mean(axis=0)
    return (
        f"{name:28} {parts[0].rank:3} {CASES[name].identifiable:3}"
        f"  {factors.mean():.4f} +- {mean:.4f}  {100 * held.mean():5.2f} +- {100 * spread:.2f}"
        f"  {single.min():5.1f} {single.max():5.1f}"
        f"  {kstest(fits, 'uniform').pvalue:5.3f} {kstest(errors, 'uniform').pvalue:5.3f}"
    )


def head(draws: int) -> list[str]:
    """What stands above the table."""
    single = 100 * np.sqrt(0.95 * 0.05 / draws)
    return [
        f"{draws} draws of {POSES} poses; coverage of one parameter: sd {single:.1f} %",
        "",
        "                           rank of    chi-squared       intervals of 95 %      p uniform",
        "                           fit docs   by freedom        that hold  least  most  fit error",
    ]


def main() -> None:
    """Print the table, and write it where asked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--draws", type=int, default=500)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--only", nargs="+", default=[])
    parser.add_argument("--write", type=Path)
    given = parser.parse_args()
    lines = head(given.draws)
    print("\n".join(lines), flush=True)
    parts = [range(i, given.draws, given.processes) for i in range(given.processes)]
    with ProcessPoolExecutor(given.processes) as pool:
        for name in (n for n in CASES if {*given.only} <= {*n.replace(",", "").split()}):
            lines.append(line(name, list(pool.map(run, repeat(name), parts))))
            print(lines[-1], flush=True)
    if given.write:
        write_block(given.write, "machines", "\n".join(lines))


if __name__ == "__main__":
    main()
