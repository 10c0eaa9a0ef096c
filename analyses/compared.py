"""How often does `compare` call an unchanged machine changed, at its level of 5 %?

Two calibrations of one machine by implicit loop, each in poses of its own over one region. The
model is right, or encoders are off centre, which no sd of a sensor describes. The sds are stated,
or one factor of the joints is learnt.

    python -m analyses.compared [--draws 400] [--first 0] [--only WORD ...] [--write FILE.md]
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

import loopcal as lc
from analyses.beyond_noise import eccentric
from analyses.gauntlet_worlds import Rng, World
from analyses.rates import interval
from analyses.written import read_block, write_block

PAGE = Path("docs/explanation/comparison.md")
SD = 1e-4
BOX = {"phi2": (0.0, 1.6), "phi3": (0.3, 1.7)}


def planar(sizes: float, poses: int, learnt: bool, rng: Rng) -> bool:
    """The arm in a plane whose first encoder is off centre by so many sds."""
    arm = lc.planar_two_link()
    how = {"phi?": "group"} if learnt else {}
    noise = lc.Noise({"?P": SD, "phi?": SD}, estimate=how)

    def day() -> lc.Result:
        at = lc.random_poses(BOX, poses, seed=int(rng.integers(2**31)))
        made = lc.simulate(arm, at, noise={"*": SD}, seed=int(rng.integers(2**31))).dataset
        readings = {q: np.array(made[q]) for q in made.quantities}
        readings["phi2"] += sizes * SD * np.sin(readings["phi2"] + readings["phi3"])
        return lc.calibrate(arm, readings, noise=noise, start="nominal", method="implicit-loop")

    return lc.compare(day(), day()).differ is True


def six_axes(sizes: float, poses: int, rng: Rng) -> bool:
    """An arm with six axes, all encoders off centre by so many sds."""
    world = World(poses=poses)
    world = replace(world, worn=eccentric(sizes * world.encoder))
    machine = int(rng.integers(2**31))

    def day() -> lc.Result:
        trial = world.made(np.random.default_rng(machine), rng)
        return lc.calibrate(
            trial.mechanism, trial.readings, noise=trial.noise, method="implicit-loop"
        )

    return lc.compare(day(), day()).differ is True


def _cases() -> dict[str, Callable[[Rng], bool]]:
    cases: dict[str, Callable[[Rng], bool]] = {}
    right = "right model"
    for sizes in (0.0, 3.0, 10.0):
        what = f"off centre by {sizes:g} sds" if sizes else right
        for learnt, how in ((False, "stated"), (True, "learnt")):
            for poses in (12, 20, 40):
                name = f"plane, {what}, sds {how}, {poses} poses"
                cases[name] = partial(planar, sizes, poses, learnt)
    for sizes, what in ((0.0, right), (4.0, "off centre by 4 sds")):
        for poses in (40, 80):
            cases[f"six axes, {what}, {poses} poses"] = partial(six_axes, sizes, poses)
    return cases


CASES = _cases()
HEAD = f"{'':50} {'draws':>5} {'alarms %':>9}"


def line(name: str, draws: list[bool]) -> str:
    """One line of the table."""
    low, high = (100.0 * end for end in interval(sum(draws), len(draws)))
    share = 100.0 * sum(draws) / len(draws)
    return f"{name:50} {len(draws):5d} {share:9.1f} ({low:.1f} to {high:.1f})"


def main() -> None:
    """Print the table, and write it into a page, which keeps the rows of other cases."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--draws", type=int, default=400)
    options.add_argument("--first", type=int, default=0, help="the first draw, a new seed each")
    options.add_argument("--only", nargs="*", default=[])
    options.add_argument("--write", type=Path, help=f"the page to write into, {PAGE}")
    asked = options.parse_args()
    warnings.simplefilter("ignore")
    known = read_block(asked.write, "compared").splitlines() if asked.write else []
    lines = {name: text for text in known for name in CASES if text[:50].rstrip() == name}
    print(HEAD)
    for number, (name, case) in enumerate(CASES.items()):
        if all(word in name for word in asked.only):
            seeds = range(asked.first, asked.first + asked.draws)
            lines[name] = line(name, [case(np.random.default_rng([17, number, s])) for s in seeds])
            print(lines[name], flush=True)
            if asked.write:
                table = [HEAD, *(lines[name] for name in CASES if name in lines)]
                write_block(asked.write, "compared", "\n".join(table))


if __name__ == "__main__":
    main()
