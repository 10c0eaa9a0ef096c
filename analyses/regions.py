"""Do stated regions hold away from the measured poses? Arms that sag, measured in a corner.

The truth is `analyses.gauntlet_truth`, which is not loopcal's code: a six-axis arm whose joints
and links give way under gravity, of which the user states nothing but the drawing. Poses fill a
corner of each joint's range. Printed are, for fresh poses inside the corner and all over the
workspace, the share of true points in the stated 95 % regions, the rms error beside the stated sd,
and how often the verdict refuses the working region.

    python -m analyses.regions [--draws 40] [--poses 60] [--share 0.35] [--write FILE]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import loopcal as lc
from analyses.gauntlet_worlds import SAGGING, Fresh, World
from analyses.lives_truth import placement
from analyses.written import write_block
from loopcal.small_samples import f_limit

PAGE = Path("docs/explanation/model-error.md")


@dataclass(frozen=True)
class Held:
    """Share of fresh poses in their stated regions; rms error and stated sd [m]."""

    share: float
    error: float
    sd: float


@dataclass(frozen=True)
class Draw:
    """What became of one machine; near: the verdict refuses the working region."""

    inside: Held
    outside: Held
    near: bool
    sound: bool | None


def held(result: lc.Result, fresh: Fresh) -> Held:
    """How the stated regions hold at fresh poses."""
    predicted = lc.predict(result, fresh.readings)
    off = np.column_stack([predicted.outputs[q] for q in fresh.outputs]) - fresh.true
    C = predicted.covariance
    squares = np.einsum("ni,ni->n", off, np.linalg.solve(C, off[:, :, None])[:, :, 0])
    return Held(
        float((squares <= predicted.region()).mean()),
        math.sqrt(float(np.square(off).sum(axis=1).mean())),
        math.sqrt(float(np.einsum("nii->n", C).mean())),
    )


def beyond(result: lc.Result, fresh: Fresh, *, placed: bool = False) -> dict[str, float] | None:
    """True error over the stated region at fresh poses; error and sd [SI], root mean squares."""
    predicted = lc.predict(result, fresh.readings)
    computed = np.column_stack([predicted.outputs[q] for q in fresh.outputs])
    if placed:
        R, shift = placement(computed, fresh.true)
        computed = computed @ R.T + shift
    index = [list(predicted.outputs).index(q) for q in fresh.outputs]
    C = predicted.covariance[:, index][:, :, index]
    off = computed - fresh.true
    usable = np.isfinite(off).all(axis=1) & np.isfinite(C).all(axis=(1, 2))
    if not usable.any():
        return None
    off, C = off[usable], C[usable]
    tiny = 1e-24 * np.eye(len(index))
    squares = np.einsum("ni,ni->n", off, np.linalg.solve(C + tiny, off[:, :, None])[:, :, 0])
    limit = f_limit(0.95, len(index), predicted.denominator[usable])
    ratio = np.sqrt(squares / limit)
    return {
        "ratio": float(np.quantile(ratio, 0.95)),
        "held": float((ratio <= 1.0).mean()),
        "error": math.sqrt(float(np.square(off).sum(axis=1).mean())),
        "sd": math.sqrt(float(np.einsum("nii->n", C).mean())),
    }


def drawn(world: World, seed: int, method: str = "auto") -> Draw:
    """One machine, measured, calibrated and judged; "auto", or the method with a model error."""
    trial = world.made(np.random.default_rng([seed, 15]))
    fit = lc.Fit(method=method, model_error="none" if method == "auto" else "structured")
    result = lc.calibrate(trial.mechanism, trial.readings, noise=trial.noise, fit=fit)
    assert trial.outside is not None
    answers = lc.verdict(result)
    return Draw(
        held(result, trial.inside),
        held(result, trial.outside),
        answers.valid.passed is False,
        answers.sound.passed,
    )


def corners(poses: int, share: float, *, stated: bool) -> World:
    """Arms that sag, measured in a corner."""
    return replace(SAGGING, poses=poses, share=share, stated=1.0 if stated else None)


def line(name: str, draws: Sequence[Draw]) -> str:
    """One line of the table."""
    parts = []
    for where in ("inside", "outside"):
        its = [getattr(draw, where) for draw in draws]
        share = 100.0 * np.mean([one.share for one in its])
        error, sd = (
            1e3 * math.sqrt(float(np.square([getattr(one, of) for one in its]).mean()))
            for of in ("error", "sd")
        )
        parts.append(f"{share:7.1f} {error:7.3f} {sd:7.3f}")
    near = 100.0 * np.mean([draw.near for draw in draws])
    return f"{name:34} {len(draws):5d} {parts[0]} {parts[1]} {near:8.0f}"


def main() -> None:
    """Print the table, and write it into a page."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--draws", type=int, default=40)
    options.add_argument("--poses", type=int, nargs="*", default=[60, 150])
    options.add_argument("--share", type=float, default=0.35)
    options.add_argument("--write", type=Path, help=f"the page to write into, {PAGE}")
    asked = options.parse_args()
    lines = [
        f"{'':34} {'':5} {'inside':>23} {'outside':>23} {'refused':>8}",
        f"{'':34} {'draws':>5}" + 2 * f" {'held %':>7} {'mm':>7} {'sd mm':>7}" + f" {'%':>8}",
    ]
    for poses in asked.poses:
        for stated in (True, False):
            world = corners(poses, asked.share, stated=stated)
            name = f"{poses} poses, sds {'stated' if stated else 'not stated'}"
            draws = [drawn(world, seed) for seed in range(asked.draws)]
            lines.append(line(name, draws))
            print(lines[-1], flush=True)
    print("\n".join(lines[:2]))
    if asked.write:
        write_block(asked.write, "regions", "\n".join(lines))


if __name__ == "__main__":
    main()
