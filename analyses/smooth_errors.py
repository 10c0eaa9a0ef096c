"""Do stated regions hold where the machine has smooth errors that nobody has a formula for?

An arm of `analyses.gauntlet_truth`, whose tool is shifted by a smooth random function of the
joints, of 0.3 mm and another kernel than loopcal's: a Gaussian one, of one length scale [rad] for
the first three joints and three times that for the others. It is measured everywhere but in a
fifth of the range of each of two joints. Printed is the share of fresh true points in the stated
95 % regions: all over, and in that gap. `none`: an arm without such an error.

    python -m analyses.smooth_errors [--draws 12] [--poses 150 300] [--first 0] [--write FILE]
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import loopcal as lc
from analyses.gauntlet_worlds import Fresh, Rng, Trial, World
from analyses.regions import held
from analyses.written import write_block

PAGE = Path("docs/explanation/model-error.md")
SIZE = 0.3e-3
SCALES = (None, 0.6, 1.0, 2.0)
_WAVES = 400
Shift = Callable[[np.ndarray], np.ndarray]


def smooth(scale: float, joints: int, rng: Rng) -> Shift:
    """(N, joints) [rad] -> (N, 3) [m], by random waves (Rahimi and Recht 2007)."""
    lengths = np.array([scale] * 3 + [3.0 * scale] * (joints - 3))
    turns = rng.standard_normal((3, _WAVES, joints)) / lengths
    phases = rng.uniform(0.0, 2.0 * np.pi, (3, _WAVES))
    size = SIZE * np.sqrt(2.0 / _WAVES)

    def shift(q: np.ndarray) -> np.ndarray:
        return np.stack(
            [size * np.cos(q @ t.T + p).sum(axis=1) for t, p in zip(turns, phases, strict=True)],
            axis=1,
        )

    return shift


def shifted(trial: Trial, scale: float | None, rng: Rng) -> tuple[Trial, Fresh]:
    """The trial with a smooth error, without the poses of a gap; and fresh poses there."""
    outputs = trial.inside.outputs
    names = [q for q in trial.inside.readings if q not in outputs]
    shift = smooth(scale or 1.0, len(names), rng)

    def at(readings: dict[str, np.ndarray]) -> np.ndarray:
        q = np.column_stack([readings[n] for n in names])
        return shift(q) * (scale is not None)

    readings, inside = dict(trial.readings), trial.inside
    off = at(readings)
    readings |= {n: readings[n] + off[:, i] for i, n in enumerate(outputs)}
    inside = replace(inside, true=inside.true + at(inside.readings))
    gap, there = (
        np.all([_in_gap(r[n], readings[n]) for n in names[:2]], axis=0)
        for r in (readings, inside.readings)
    )
    few = {n: row[~gap] for n, row in readings.items()}
    return replace(trial, readings=few, inside=_of(inside, ~there)), _of(inside, there)


def _in_gap(q: np.ndarray, measured: np.ndarray) -> np.ndarray:
    low, high = float(measured.min()), float(measured.max())
    share: np.ndarray = (q - low) / (high - low)
    return (share > 0.35) & (share < 0.65)


def _of(fresh: Fresh, chosen: np.ndarray) -> Fresh:
    readings = {n: row[chosen] for n, row in fresh.readings.items()}
    return replace(fresh, readings=readings, true=fresh.true[chosen])


def drawn(scale: float | None, poses: int, seed: int) -> tuple[float, float]:
    """Shares of fresh points in their regions, where poses were measured and in the gap."""
    rng = np.random.default_rng([seed, poses, int(10 * (scale or 0))])
    trial, gap = shifted(World(poses=poses).made(rng), scale, rng)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = lc.calibrate(
            trial.mechanism,
            trial.readings,
            noise=trial.noise,
            method="least-squares",
            model_error="structured",
        )
    return held(result, trial.inside).share, held(result, gap).share


def main() -> None:
    """Print the table, and write it into a page."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--draws", type=int, default=12)
    options.add_argument("--poses", type=int, nargs="*", default=[150, 300])
    options.add_argument("--first", type=int, default=0)
    options.add_argument("--write", type=Path, help=f"the page to write into, {PAGE}")
    asked = options.parse_args()
    lines = [
        f"{'length scale [rad]':20} {'poses':>5} {'draws':>5} {'held %':>7} {'in the gap %':>12}"
    ]
    print(lines[0])
    for poses in asked.poses:
        for scale in SCALES:
            seeds = range(asked.first, asked.first + asked.draws)
            found = 100.0 * np.array([drawn(scale, poses, seed) for seed in seeds])
            told = np.nanmean(found, axis=0)
            name = "none" if scale is None else f"{scale:g}"
            row = f"{name:20} {poses:5d} {asked.draws:5d} {told[0]:7.1f} {told[1]:12.1f}"
            lines.append(row)
            print(row, flush=True)
    if asked.write:
        write_block(asked.write, "smooth_errors", "\n".join(lines))


if __name__ == "__main__":
    main()
