"""Do stated regions and comparisons hold where errors are more than the noise of sensors?

The truth is `analyses.gauntlet_truth`, which is not loopcal's code. Judged is the default call,
with the sds of the sensors stated. Three questions:

- an instrument that drifts (AR(1)) along a path: how many true points of fresh poses lie in the
  stated 95 % regions, and how often the verdict speaks of the drift;
- joints off centre by about the noise of their encoders: the same regions, and the 95 % intervals
  of the link lengths of an arm in a plane;
- an unchanged arm that sags, calibrated on two days: how often `compare` finds a difference at 5 %,
  both days all over the workspace, and each in a corner of its own.

    python -m analyses.beyond_noise [--draws 30] [--first 0] [--only WORD ...] [--write FILE.md]
"""

from __future__ import annotations

import argparse
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import loopcal as lc
from analyses.gauntlet_kinds import ALONG
from analyses.gauntlet_truth import PLANAR, Arm
from analyses.gauntlet_worlds import BUILT, SAGGING, Rng, Trial, World, wandering
from analyses.regions import held
from analyses.written import read_block, write_block
from loopcal.document.aliases import confidence

PAGE = Path("docs/explanation/model-error.md")


@dataclass(frozen=True)
class Seen:
    """Of one draw: share of what was stated that holds; whether it was told, None: not asked."""

    held: float
    told: bool | None = None


def drifting(persistence: float, sd: float, rng: Rng) -> Seen:
    """A tracker that drifts along a path."""
    world = World(poses=150, order="path", event=wandering(persistence, sd))
    trial = world.made(rng)
    result = calibrated(trial)
    told = lc.verdict(result)
    words = " ".join(f"{a.code} {a.words}" for a in told.answers.values())
    return Seen(held(result, trial.inside).share, re.search(ALONG, words) is not None)


def off_centre(sizes: float, rng: Rng) -> Seen:
    """Joints off centre by so many sds of their encoders."""
    world = World()
    trial = replace(world, worn=eccentric(sizes * world.encoder)).made(rng)
    return Seen(held(calibrated(trial), trial.inside).share)


def lengths(sizes: float, rng: Rng) -> Seen:
    """The same of an arm in a plane, whose link lengths are known."""
    world = World("planar", poses=40)
    arm = eccentric(sizes * world.encoder)(PLANAR.perturbed(rng, *BUILT), rng)
    result = calibrated(replace(world, worn=lambda _, rng: arm).made(rng))
    ends = confidence(result, 0.05)
    true = {f"l{i + 2}": link.a for i, link in enumerate(arm.links)}
    inside = [ends[name][0] <= value <= ends[name][1] for name, value in true.items()]
    return Seen(float(np.mean(inside)))


def eccentric(amplitude: float) -> Callable[[Arm, Rng], Arm]:
    """Joints whose encoders are off centre [rad]."""

    def worn(arm: Arm, rng: Rng) -> Arm:
        phases = rng.uniform(0.0, 2.0 * np.pi, len(arm.links))
        gears = [(amplitude, phase, 0.0, 0.0) for phase in phases]
        return replace(arm, gears=np.array(gears))

    return worn


def compared(share: float, poses: int, rng: Rng) -> Seen:
    """An unchanged arm that sags, on two days: told is a false alarm."""
    world = replace(SAGGING, poses=poses, share=share)
    machine = int(rng.integers(2**31))
    days = [world.made(np.random.default_rng(machine), rng) for _ in range(2)]
    found = lc.compare(*(calibrated(day) for day in days))
    return Seen(1.0 - (found.differ is True), found.differ is True)


def calibrated(trial: Trial) -> lc.Result:
    """By the default call."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return lc.calibrate(trial.mechanism, trial.readings, noise=trial.noise, method="auto")


CASES: dict[str, Callable[[Rng], Seen]] = {
    "drift, AR(1) 0.95": lambda rng: drifting(0.95, 6e-5, rng),
    "drift, AR(1) 0.6": lambda rng: drifting(0.6, 3e-5, rng),
    "drift, AR(1) 0.6, strong": lambda rng: drifting(0.6, 1.2e-4, rng),
    "eccentric by 0.5 sds": lambda rng: off_centre(0.5, rng),
    "eccentric by 1 sd": lambda rng: off_centre(1.0, rng),
    "eccentric by 3 sds": lambda rng: off_centre(3.0, rng),
    "lengths, eccentric by 0.5 sds": lambda rng: lengths(0.5, rng),
    "lengths, eccentric by 1 sd": lambda rng: lengths(1.0, rng),
    "lengths, eccentric by 3 sds": lambda rng: lengths(3.0, rng),
    "compare, sag, whole workspace": lambda rng: compared(1.0, 80, rng),
    "compare, sag, two corners": lambda rng: compared(0.35, 60, rng),
}
HEAD = f"{'':32} {'draws':>5} {'held %':>7} {'+-':>4} {'named %':>8}"


def line(name: str, draws: list[Seen]) -> str:
    """One line of the table."""
    shares = 100.0 * np.array([draw.held for draw in draws])
    error = shares.std(ddof=1) / np.sqrt(len(draws))
    told = [draw.told for draw in draws if draw.told is not None]
    share = f"{100.0 * np.mean(told):8.0f}" if told else "       -"
    return f"{name:32} {len(draws):5d} {shares.mean():7.1f} {error:4.1f} {share}"


def main() -> None:
    """Print the table, and write it into a page, which keeps the rows of other cases."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--draws", type=int, default=30)
    options.add_argument("--first", type=int, default=0, help="the first draw, a new seed each")
    options.add_argument("--only", nargs="*", default=[])
    options.add_argument("--write", type=Path, help=f"the page to write into, {PAGE}")
    asked = options.parse_args()
    known = read_block(asked.write, "beyond_noise").splitlines() if asked.write else []
    lines = {name: text for text in known for name in CASES if text[:32].rstrip() == name}
    print(HEAD)
    for number, (name, case) in enumerate(CASES.items()):
        if all(word in name for word in asked.only):
            seeds = range(asked.first, asked.first + asked.draws)
            draws = [case(np.random.default_rng([16, number, s])) for s in seeds]
            lines[name] = line(name, draws)
            print(lines[name], flush=True)
            if asked.write:
                table = [HEAD, *(lines[name] for name in CASES if name in lines)]
                write_block(asked.write, "beyond_noise", "\n".join(table))


if __name__ == "__main__":
    main()
