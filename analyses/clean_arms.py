"""What a model error costs on arms that have none, or little.

The truth is `analyses.gauntlet_truth`: arms of five types whose zeros are off by 2 to 10 mrad,
twists by 0.5 to 2 mrad and lengths by 0.1 to 1 mm (sds, drawn for each arm), measured at 30 to 120
poses in random order, sorted by the first joint or along a path, all over the joints' ranges or in
half of each. With `--weak` each arm also sags and has gears out of round, from far below the noise
to well above it. The user states the drawing, and the sds of the sensors or none.

Printed are, inside the measured ranges and outside: the true rms error at fresh poses over that of
the implicit loop and of least squares (geometric means), how often it exceeds them by more than a
tenth, the share of fresh true points in the stated 95 % regions, and the mean of true error over
stated sd; and how many verdicts are sound.

    python -m analyses.clean_arms [--draws 120] [--first 0] [--weak] [--processes 2] [--keep FILE]
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
from analyses.gauntlet import STAMP, beyond
from analyses.gauntlet_kinds import Kind
from analyses.gauntlet_truth import Arm
from analyses.gauntlet_worlds import Rng, World
from analyses.kept import complete

MACHINES = ("six", "ur", "irb", "seven", "scara")
METHODS = ("auto", "implicit-loop", "least-squares")
WEAK = "weak"


def world(draw: int, *, weak: bool) -> World:
    """The family of one arm."""
    rng = np.random.default_rng([77, draw])
    zero, twist = rng.uniform(2e-3, 10e-3), rng.uniform(0.5e-3, 2e-3)
    length = 10.0 ** rng.uniform(-4.0, -3.0)

    def worn(arm: Arm, rng: Rng) -> Arm:
        links = tuple(
            replace(
                link,
                offset=link.offset + (0.0 if link.slides else zero * rng.standard_normal()),
                alpha=link.alpha + twist * rng.standard_normal(),
                a=link.a + length * rng.standard_normal(),
                d=link.d + length * rng.standard_normal() * (link.beta is None),
            )
            for link in arm.links
        )
        arm = replace(arm, links=links)
        if not weak:
            return arm
        yields, gears = 10.0 ** rng.uniform(-7.5, -5.7), 10.0 ** rng.uniform(-5.3, -3.5)
        n = len(links)
        sizes = gears * rng.standard_normal((2, n)) * [[1.0], [0.5]]
        phases = rng.uniform(0.0, 2.0 * np.pi, (2, n))
        columns = np.column_stack([sizes[0], phases[0], sizes[1], phases[1]])
        return replace(arm, yielding=yields, bending=0.3 * yields, gears=columns)

    return World(
        MACHINES[draw % len(MACHINES)],
        poses=int(rng.choice([30, 60, 120])),
        share=float(rng.choice([0.5, 1.0])),
        stated=rng.choice(np.array([1.0, None])),
        order=str(rng.choice(["random", "sweep", "path"])),
        worn=worn,
    )


def run(name: str, draw: int) -> dict[str, Any]:
    """What each method makes of one arm."""
    kind = Kind(name, world(draw, weak=name == WEAK), clean=True)
    trial = kind.world.made(np.random.default_rng([78, draw]))
    made: dict[str, Any] = {"kind": name, "draw": draw, "stamp": STAMP}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for method in METHODS:
            try:
                result = lc.calibrate(
                    trial.mechanism, trial.readings, noise=trial.noise, method=method
                )
            except lc.LoopcalError:
                continue  # without any stated sd there is no implicit loop
            made[f"{method} inside"] = beyond(result, trial.inside, kind)
            if trial.outside is not None:
                made[f"{method} outside"] = beyond(result, trial.outside, kind)
            if method == "auto":
                sound = lc.verdict(result).answers["sound"]
                made |= {"sound": sound.passed, "code": sound.code}
    return made


def lines(draws: list[dict[str, Any]]) -> str:
    """The table."""
    text = "poses     draws  over implicit loop  over least squares  held %  error / sd\n"
    for where in ("inside", "outside"):
        judged = [d for d in draws if d.get(f"auto {where}")]
        row = f"{where:8} {len(judged):6}"
        for rival in METHODS[1:]:
            ratios = np.array(
                [
                    d[f"auto {where}"]["error"] / d[f"{rival} {where}"]["error"]
                    for d in judged
                    if d.get(f"{rival} {where}")
                ]
            )
            mean, above = math.exp(float(np.log(ratios).mean())), 100.0 * (ratios > 1.1).mean()
            row += f"  {mean:7.3f}, 10 % {above:3.0f} %"
        held = np.mean([d[f"auto {where}"]["held"] for d in judged])
        size = np.mean([d[f"auto {where}"]["error"] / d[f"auto {where}"]["sd"] for d in judged])
        text += f"{row}  {100.0 * held:6.1f}  {size:10.2f}\n"
    sound = sum(bool(d.get("sound")) for d in draws)
    codes = sorted({d["code"] for d in draws if not d.get("sound")})
    return f"{text}\nsound: {sound} of {len(draws)}" + (f" (else {', '.join(codes)})" * bool(codes))


def main() -> None:
    """Run what is missing and print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--draws", type=int, default=120)
    options.add_argument("--first", type=int, default=0, help="the first draw, a new arm each")
    options.add_argument("--weak", action="store_true")
    options.add_argument("--processes", type=int, default=2)
    options.add_argument("--keep", type=Path, default=Path(".cache/clean_arms.jsonl"))
    chosen = options.parse_args()
    name = WEAK if chosen.weak else "clean"
    asked = [(name, i) for i in range(chosen.first, chosen.first + chosen.draws)]
    print(lines(complete(chosen.keep, asked, run, chosen.processes, STAMP)))


if __name__ == "__main__":
    main()
