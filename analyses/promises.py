"""Is the calibrated machine as accurate as `plan` promised, where it bends and where it does not?

Three arms of `analyses.gauntlet_truth`, as they are drawn but for 0.3 mm and 0.5 mrad, give way by
nothing, 4 and 20 microrad per N m. The user knows the drawing and the sds of the sensors. A plan of
30 poses is measured and calibrated by the default call; then a plan of 15 poses more, which
knows the first calibration. Beside what each plan promises stands the rms error that the
calibration has at 400 fresh poses, placed rigidly, with exact joints.

    python -m analyses.promises [--draws 2] [--first 0] [--processes 2] [--write FILE]
"""

from __future__ import annotations

import argparse
import math
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import loopcal as lc
from analyses import gauntlet_truth as truth
from analyses.gauntlet import stamp
from analyses.gauntlet_truth import Array, drawn, random_placement
from analyses.gauntlet_worlds import ARMS, BUILT, MOUNTED, TOOL, World
from analyses.kept import complete
from analyses.lives_truth import away
from analyses.written import write_block

MACHINES = ("six", "irb", "ur")
YIELDS = {"stiff": 0.0, "sagging": 4e-6, "soft": 2e-5}
"""rad per N m about each joint's axis; three tenths of it across."""
CANDIDATES, FIRST, FURTHER, FRESH = 150, 30, 15, 400


class Measured:
    """An arm as it was built, and the tracker that reads it."""

    def __init__(self, machine: str, yields: float, draw: int) -> None:
        self.rng = np.random.default_rng([79, draw])
        self.world, self.box = World(machine), truth.BOXES[machine]
        arm = ARMS[machine].perturbed(self.rng, *BUILT)
        self.arm = replace(arm, yielding=yields, bending=0.3 * yields)
        self.mounted = TOOL + MOUNTED * self.rng.standard_normal(3)
        self.turn, self.shift = random_placement(self.rng, 2.0)
        self.names = [f"q{i + 1}" for i in range(len(self.box))]
        self.mechanism = self.world._mechanism(np.zeros(3), TOOL[None])
        self.noise = self.world._noise(self.mechanism)

    def points(self, q: Array) -> Array:
        """True points (N, 3) [m] in the tracker's frame."""
        R, o = self.arm.flange(q)
        points: Array = (o + np.einsum("nij,j->ni", R, self.mounted)) @ self.turn.T + self.shift
        return points

    def read(self, poses: lc.Dataset) -> dict[str, Array]:
        """Readings of the poses of a plan."""
        q = np.column_stack([poses[name] for name in self.names])
        p = self.points(q) + self.world.sd * self.rng.standard_normal((len(q), 3))
        return self.world._joints(q, self.rng) | dict(zip("xyz", p.T, strict=True))

    def error(self, result: lc.Result) -> float:
        """Rms [m] at fresh poses."""
        q = drawn(self.box, FRESH, self.rng)
        computed = lc.predict(result, dict(zip(self.names, q.T, strict=True))).outputs
        here, true = np.column_stack([computed[c] for c in "xyz"]), self.points(q)
        return math.sqrt(float(np.square(away(here, true)).mean()))


def run(name: str, draw: int) -> dict[str, Any]:
    """One arm, measured twice."""
    machine, kind = name.split()
    cell = Measured(machine, YIELDS[kind], draw)
    ranges = {q: (float(a), float(b)) for q, (a, b) in zip(cell.names, cell.box, strict=True)}
    settings = lc.PlanSettings(ranges, number=CANDIDATES)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plan = lc.plan(cell.mechanism, FIRST, noise=cell.noise, settings=settings)
        first = cell.read(plan.poses)
        result = lc.calibrate(cell.mechanism, first, noise=cell.noise, method="auto")
        more = lc.plan(cell.mechanism, FURTHER, existing=result, settings=settings)
        further = cell.read(more.poses)
        both = {q: np.concatenate([v, further[q]]) for q, v in first.items()}
        final = lc.calibrate(cell.mechanism, both, noise=cell.noise, method="auto")
    assert plan.rigid is not None
    return {
        "kind": name,
        "draw": draw,
        "stamp": stamp(),
        "rigid": plan.rigid.end_point,
        "promised": plan.expected.end_point,
        "found": cell.error(result),
        "promised again": more.expected.end_point,
        "found again": cell.error(final),
    }


def table(draws: list[dict[str, Any]]) -> str:
    """Geometric means over draws [mm]."""
    text = (
        "arm        rigid  promised   found   with the first calibration: promised   found  ratio\n"
    )
    for kind in YIELDS:
        some = [d for d in draws if d["kind"].endswith(kind)]
        keys = ("rigid", "promised", "found", "promised again", "found again")
        means = [1e3 * math.exp(np.mean([math.log(d[key]) for d in some])) for key in keys]
        a, b, c, d, e = means
        text += f"{kind:9} {a:6.3f} {b:9.3f} {c:7.3f} {d:38.3f} {e:7.3f} {e / d:6.2f}\n"
    return text + f"\n{len(draws)} sets of {len(MACHINES)} arms"


def main() -> None:
    """Run what is missing and print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--draws", type=int, default=2)
    options.add_argument("--first", type=int, default=0, help="the first draw, a new arm each")
    options.add_argument("--processes", type=int, default=2)
    options.add_argument("--keep", type=Path, default=Path(".cache/promises.jsonl"))
    options.add_argument("--write", type=Path)
    chosen = options.parse_args()
    wanted = range(chosen.first, chosen.first + chosen.draws)
    asked = [(f"{machine} {kind}", i) for i in wanted for machine in MACHINES for kind in YIELDS]
    text = table(complete(chosen.keep, asked, run, chosen.processes, stamp()))
    print(text)
    if chosen.write:
        write_block(chosen.write, "promises", text)


if __name__ == "__main__":
    main()
