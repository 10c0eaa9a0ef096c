"""Drifts along the run: how often the default call models one that is there, or none that is not.

The truth is `analyses.gauntlet_truth`, which is not loopcal's code. A six-axis arm gives way under
gravity, a light one is out of round and has backlash too. Meanwhile the readings drift: in
proportion to the number of the pose, or as an instrument warms up, with half of the drift in the
first fifth of the run. Poses are in random order, along a smooth path, or sorted by the first
joint, which no drift can be told from. Printed are how often the fit models a ramp, how often the
verdict says yes, open and no, how many true points of fresh poses lie in their 95 % regions (moved
onto the fresh poses first, for the machine itself has not changed), and in how many draws the error
at 95 % of the poses is beyond 1.5 times the stated region although the result is not refused.

    python -m analyses.ramps [--draws 10] [--first 0] [--write FILE.md]
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import loopcal as lc
from analyses.gauntlet_worlds import Rng, Run, World, bending, worn_all_over
from analyses.regions import beyond
from analyses.written import write_block

PAGE = Path("docs/explanation/drift.md")
DRIFTS = {"none": 0.0, "0.1 mm": 1e-4, "0.3 mm": 3e-4, "0.1 mm, warming up": 1e-4}
ORDERS = ("random", "path", "sweep")
ARMS = {"sags": bending, "light": worn_all_over}


@dataclass(frozen=True)
class Seen:
    """Of one draw: whether a ramp is modelled, what the verdict says, and what the regions do."""

    modelled: bool
    passed: bool | None
    held: float
    ratio: float


def drifting(drift: str) -> Callable[[Run, Rng], None]:
    """An instrument whose readings drift in one direction."""

    def event(run: Run, rng: Rng) -> None:
        t = np.linspace(0.0, 1.0, len(run.drift))
        if "warming" in drift:
            t = (1.0 - 2.0 ** (-5.0 * t)) / (1.0 - 2.0**-5)
        way = rng.standard_normal(3)
        run.drift += DRIFTS[drift] * t[:, None] * way / np.linalg.norm(way)

    return event


def drawn(arm: str, order: str, drift: str, seed: int, poses: int = 150) -> Seen:
    """One run with one drift."""
    world = World(poses=poses, order=order, worn=ARMS[arm], event=drifting(drift))
    trial = world.made(np.random.default_rng([29, seed]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = lc.calibrate(trial.mechanism, trial.readings, noise=trial.noise, method="auto")
        verdict = lc.verdict(result)
    points = result.document.change_points
    ramps = [p for p in points.found if p.shape == "ramp" and p.modelled] if points else []
    off = beyond(result, trial.inside, placed=True) or {"held": np.nan, "ratio": np.nan}
    return Seen(bool(ramps), verdict.answers["sound"].passed, off["held"], off["ratio"])


def row(arm: str, order: str, drift: str, seeds: range) -> str:
    """One line of the table."""
    seen = [drawn(arm, order, drift, seed) for seed in seeds]
    count = [sum(s.passed is passed for s in seen) for passed in (True, None, False)]
    wrong = sum(s.ratio > 1.5 and s.passed is not False for s in seen)
    return (
        f"{arm:7}{order:8}{drift:20}{sum(s.modelled for s in seen):8d} {count[0]:5d}{count[1]:6d}"
        f"{count[2]:4d} {100 * np.nanmean([s.held for s in seen]):9.1f} {wrong:7d}"
    )


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--write", type=Path, help=f"the page to write into, {PAGE}")
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.draws)
    lines = [f"{args.draws} draws a row, 150 poses\n"]
    lines += ["arm    order   drift               modelled sound  open  no  held [%]   wrong"]
    print(*lines, sep="\n", flush=True)
    for arm in ARMS:
        for order in ORDERS:
            for drift in DRIFTS:
                lines.append(row(arm, order, drift, seeds))
                print(lines[-1], flush=True)
    if args.write:
        write_block(args.write, "ramps", "\n".join(lines))


if __name__ == "__main__":
    main()
