"""How often is a good pose called an outlier where the residuals are the scale?

Clean sets of seven machines, fitted by least squares; `learnt` are 12 poses of the default call
with learnt sds. Counted are sets in which the verdict says that a pose does not fit: 1 % are meant.
`sagging` are clean arms that give way by 20 microrad per N m, by the default call; counted are
sets of which `find_outliers` names any pose, 5 % are meant.

    python -m analyses.residual_outliers [--draws 60] [--first 0] [--sagging]
"""

from __future__ import annotations

import argparse
import warnings

import numpy as np

import loopcal as lc
from analyses.gauntlet_worlds import World, bending
from analyses.rates import interval

CASES = {
    "six axes, 30 poses": World(poses=30),
    "six axes, 80 poses": World(),
    "six axes, 200 poses": World(poses=200),
    "six axes, poor encoders": World("irb", encoder=3e-4),
    "UR": World("ur", poses=60),
    "SCARA": World("scara"),
    "seven axes": World("seven", poses=100),
    "planar arm, 40 poses": World("planar", poses=40),
}
LEARNT = "12 poses, sds learnt"
SAGGING = ("six", "irb", "ur", "seven")


def sagging(machine: str, seed: int) -> bool:
    """Whether any pose of a clean sagging arm is named at the level of 5 %."""
    trial = World(machine, poses=60, worn=bending).made(np.random.default_rng([97, seed]))
    result = lc.calibrate(trial.mechanism, trial.readings, noise=trial.noise, method="auto")
    return bool(lc.find_outliers(result).found)


def named(world: World, seed: int, method: str) -> bool:
    """Whether the verdict on one draw speaks of poses that do not fit."""
    trial = world.made(np.random.default_rng([97, seed]))
    noise = trial.noise if method == "auto" else None
    result = lc.calibrate(trial.mechanism, trial.readings, noise=noise, method=method)
    return "not fit the others" in lc.verdict(result).sound.words


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--draws", type=int, default=60)
    options.add_argument("--first", type=int, default=0, help="the first draw, a new seed each")
    options.add_argument("--sagging", action="store_true", help="these alone")
    asked = options.parse_args()
    warnings.simplefilter("ignore")
    seeds, found = range(asked.first, asked.first + asked.draws), 0
    if asked.sagging:
        found = sum(sagging(SAGGING[seed % len(SAGGING)], seed) for seed in seeds)
        low, high = (100.0 * end for end in interval(found, asked.draws))
        print(f"{'sagging arms':26} {asked.draws:4d} {100.0 * found / asked.draws:6.1f}", end=" ")
        print(f"({low:.1f} to {high:.1f})")
        return
    for name, world in CASES.items():
        own = sum(named(world, seed, "least-squares") for seed in seeds)
        found += own
        print(f"{name:26} {asked.draws:4d} {100.0 * own / asked.draws:6.1f}", flush=True)
    count = asked.draws * len(CASES)
    low, high = (100.0 * end for end in interval(found, count))
    print(f"{'all':26} {count:4d} {100.0 * found / count:6.1f} ({low:.1f} to {high:.1f})")
    few = seeds[: asked.draws // 4]
    own = sum(named(World(poses=12, learnt=True), seed, "auto") for seed in few)
    print(f"{LEARNT:26} {len(few):4d} {100.0 * own / len(few):6.1f}")


if __name__ == "__main__":
    main()
