"""What a change along the run does to the stated regions, by its size beside the predicted sd.

The truth is `analyses.gauntlet_truth`, which is not loopcal's code. The tracker of a six-axis arm
drifts in one direction by a share of the predicted sd, all along the run, or the target slips by as
much in its middle. Each of the draws is calibrated with the stated sds, without model error, and
the change stays in. Printed are how often the change is found, how often the verdict then says "no"
or "open", how many true points of fresh poses lie in their 95 % regions, and the largest error at
95 % of the poses beside the stated region: 1.5 is what the gauntlet calls wrong.

    python -m analyses.small_changes [--draws 10] [--poses 400] [--write FILE.md]
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import loopcal as lc
from analyses.gauntlet_worlds import Rng, Run, World
from analyses.regions import beyond
from analyses.written import write_block

PAGE = Path("docs/explanation/verdict.md")
SIZES = (0.1, 0.25, 0.5, 1.0, 2.0)
SD = 5.6e-5
"""What such a calibration predicts [m], root of the sum over the coordinates."""


@dataclass(frozen=True)
class Seen:
    """Of one draw: whether the change was found, what the verdict says, and what the regions do."""

    found: bool
    passed: bool | None
    held: float
    ratio: float


def drawn(shape: str, size: float, poses: int, seed: int) -> Seen:
    """One run with one change of so many predicted sds."""
    rng = np.random.default_rng([17, seed, poses])
    way = rng.standard_normal(3)
    way *= size * SD / np.linalg.norm(way)

    def event(run: Run, rng: Rng) -> None:
        count = len(run.shift)
        if shape == "ramp":
            run.shift += np.linspace(0.0, 1.0, count)[:, None] * way
        else:
            run.target[count // 2 :, 0] += way

    world = World(poses=poses, event=event)
    trial = world.made(rng)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = lc.calibrate(
            trial.mechanism, trial.readings, noise=trial.noise, method="implicit-loop"
        )
        sound = lc.verdict(result).sound
    points = lc.find_shifts(result).found
    region = beyond(result, trial.inside)
    assert region is not None
    told = sound.passed if sound.code in ("change-points", "changes-small") else True
    return Seen(bool(points), told, region["held"], region["ratio"])


def line(shape: str, size: float, draws: list[Seen]) -> str:
    """One line of the table."""
    found, no, little = (
        100.0 * np.mean([which(one) for one in draws])
        for which in (
            lambda one: one.found,
            lambda one: one.passed is False,
            lambda one: one.passed is None,
        )
    )
    held = 100.0 * np.mean([one.held for one in draws])
    ratio = max(one.ratio for one in draws)
    return (
        f"{shape:6} {size:5.2f} {len(draws):6d} {found:8.0f} {no:6.0f} {little:7.0f} {held:8.1f} "
        f"{ratio:8.2f}"
    )


def main() -> None:
    """Print the table, and write it into a page."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--draws", type=int, default=10)
    options.add_argument("--poses", type=int, default=400)
    options.add_argument("--write", type=Path, help=f"the page to write into, {PAGE}")
    asked = options.parse_args()
    head = f"{'change':6} {'[sd]':>5} {'draws':>6} {'found %':>8} {'no %':>6} {'open %':>7}"
    lines = [f"{head} {'held %':>8} {'largest':>8}"]
    print(lines[0])
    for shape in ("ramp", "step"):
        for size in SIZES:
            seen = [drawn(shape, size, asked.poses, seed) for seed in range(asked.draws)]
            lines.append(line(shape, size, seen))
            print(lines[-1], flush=True)
    if asked.write:
        write_block(asked.write, "small_changes", "\n".join(lines))


if __name__ == "__main__":
    main()
