"""Do effects beyond geometry calibrate, and is the right model recommended?

First, coverage: simulated calibrations of the six-axis arm with one effect at a time and with all,
their parameters drawn from their priors, the geometry of the drawing. Each setup counts how often
the 95 % interval of an effect's parameter and of any parameter holds the truth, and compares
chi-squared with its degrees of freedom. Second, recommendation: geometric truth, or one true
effect, and how often comparing models names which.

    python -m analyses.effects [--draws 500] [--choices 200] [--processes 2] [--only WORD ...]
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import repeat

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kstest

import loopcal as lc
from loopcal.estimation.calibrate import calibrate
from loopcal.mechanisms.effects.effect import Effect

Array = NDArray[np.float64]
SIGMAS = 1.959963984540054
JOINTS = tuple(f"theta_{i}" for i in range(1, 7))
RANGES = dict(
    zip(
        JOINTS,
        [(-1.6, 1.6), (-0.8, 1.4), (-0.9, 1.8), (-2.4, 2.4), (-1.5, 1.5), (-2.9, 2.9)],
        strict=True,
    )
)
SDS = lc.Noise({"theta_*": 5e-5, "?": 2e-5})
WRIST, ELBOW = lc.effects.Load("wrist", "theta_5"), lc.effects.Load("elbow", "theta_3")
WEIGHED = (
    lc.effects.Load("wrist", "theta_5", mass=20.0),
    lc.effects.Load("elbow", "theta_3", mass=60.0),
)
SETUPS: dict[str, Sequence[Effect]] = {
    "harmonics": [lc.effects.Harmonics(JOINTS[:3])],
    "scale": [lc.effects.Scale()],
    "sag": [lc.effects.Compliance((WRIST, ELBOW), ("theta_[12346]", "phi[xy]0"))],
    "yield": [lc.effects.Compliance(WEIGHED, ("theta_[1234]", "phi[xy]0"))],
    "backlash": [lc.effects.Backlash()],
    "drift": [lc.effects.Drift(("[xy]0", "z1", "?6B"))],
    "shift": [lc.effects.Shift(("?6B",), (20, 60))],
}
SETUPS["all"] = [effect for one in SETUPS.values() for effect in one if one != SETUPS["yield"]]
POSES = 150
MODELS = {name: lc.Model((name,)) for name in ("harmonics", "scale", "sag")} | {
    "all three": lc.Model(("harmonics", "scale", "sag"))
}


@dataclass(frozen=True)
class Counts:
    """Of some draws: own, every: shares of intervals that held; z: chi-squared over freedom."""

    own: Array
    every: Array
    chi_squared: Array
    p_values: Array


def arm(setup: str) -> lc.Mechanism:
    """The MA1400 with these effects, the placement of its base known to 1 mm and 1 mrad."""
    plain = lc.motoman_ma1400({"z1": 0.45, "x6B": 0.05, "z6B": -0.45})
    return lc.with_effects(plain, SETUPS[setup])


def driven(mechanism: lc.Mechanism, seed: int, poses: int = POSES) -> dict[str, Array]:
    """Random joints; directions of approach, and the number of the pose for what drifts."""
    rng = np.random.default_rng([3, seed])
    known = {"t": np.linspace(0.0, 1.0, poses), "pose": np.arange(1.0, poses + 1)}
    known |= {f"{q}_direction": rng.choice([-1.0, 1.0], poses) for q in JOINTS}
    found = lc.random_poses(RANGES, poses, seed=seed)
    return dict(found) | {name: known[name] for name in mechanism.pose_constants}


def truth_of(mechanism: lc.Mechanism, seed: int) -> dict[str, float]:
    """Effects drawn from their priors; lengths and angles off by 1 mm and 1 mrad."""
    rng = np.random.default_rng([5, seed])
    own = {name for names in mechanism.effects.values() for name in names}
    z = rng.standard_normal(len(mechanism.parameters))
    return {
        p.name: p.nominal + v * (p.prior_sd if p.name in own else 1e-3)
        for p, v in zip(mechanism.parameters, z, strict=True)
    }


def run(setup: str, seeds: Sequence[int]) -> Counts:
    """Calibrations of draws whose truth is known."""
    mechanism = arm(setup)
    own = [name for names in mechanism.effects.values() for name in names]
    columns: list[list[float]] = [[], [], [], []]
    for seed in seeds:
        truth = truth_of(mechanism, seed)
        made = lc.simulate(mechanism, driven(mechanism, 1), noise=SDS, seed=seed, truth=truth)
        found = calibrate(  # columns that a simulation made are not at fault
            mechanism,
            made.dataset,
            noise=SDS,
            trusted=True,
            start="nominal",
            method="implicit-loop",
        )
        assert found.status.converged
        assert found.chi_squared is not None
        held = {
            n: abs(found.value[n] - truth[n]) <= SIGMAS * (found.sd[n] or 0.0)
            for n in found.estimated
        }
        columns[0].append(float(np.mean([held[n] for n in own])))
        columns[1].append(float(np.mean(list(held.values()))))
        columns[2].append(found.chi_squared.variance_factor or np.nan)
        columns[3].append(found.chi_squared.p_value or 0.0)
    return Counts(*(np.array(column) for column in columns))


def chosen(true: str, seed: int, poses: int = 100, folds: int = 10) -> str:
    """The model that comparing recommends where one effect is there, or none ("geometric")."""
    names = ("harmonics", "scale", "sag")
    plain = lc.motoman_ma1400({"z1": 0.45, "x6B": 0.05, "z6B": -0.45})
    mechanism = lc.with_effects(plain, [effect for name in names for effect in _named(name)])
    full = truth_of(mechanism, seed)
    there: Mapping[str, tuple[str, ...]] = mechanism.effects
    off = [p for name, own in there.items() if name != true for p in own]
    truth = full | dict.fromkeys(off, 0.0)
    made = lc.simulate(mechanism, driven(mechanism, seed, poses), noise=SDS, seed=seed, truth=truth)
    found = lc.compare_models(
        mechanism,
        made.dataset,
        MODELS,
        noise=SDS,
        start="nominal",
        folds=folds,
        seed=seed,
        method="implicit-loop",
    )
    return found.recommended


def _named(name: str) -> list[Effect]:
    """The effects of a setup; compliance under the name of its setup."""
    if name == "sag":
        return [lc.effects.Compliance((WRIST, ELBOW), ("theta_2", "theta_3"), name="sag")]
    return list(SETUPS[name])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=500)
    parser.add_argument("--choices", type=int, default=200)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--only", nargs="+", default=[*SETUPS])
    given = parser.parse_args()
    with ProcessPoolExecutor(given.processes) as pool:
        print(f"{given.draws} draws; coverage of 95 % intervals [%], +- Monte Carlo standard error")
        print("effect      of its parameters   of all          chi-squared / freedom  p uniform")
        for setup in given.only:
            parts = np.array_split(np.arange(given.draws), given.processes)
            counts = list(pool.map(run, repeat(setup), parts))
            own, every, chi, p = (
                np.concatenate([getattr(c, key) for c in counts])
                for key in ("own", "every", "chi_squared", "p_values")
            )
            error = 1.0 / np.sqrt(len(own))
            print(
                f"{setup:10}  {100 * own.mean():6.2f} +- {100 * own.std(ddof=1) * error:.2f}"
                f"     {100 * every.mean():6.2f} +- {100 * every.std(ddof=1) * error:.2f}"
                f"   {chi.mean():.4f} +- {chi.std(ddof=1) * error:.4f}"
                f"     {kstest(p, 'uniform').pvalue:.3f}",
                flush=True,
            )
        if given.choices:
            print(f"\n{given.choices} draws of each truth; recommended model")
        for true in ("geometric", "harmonics", "scale", "sag") if given.choices else ():
            found = Counter(pool.map(chosen, repeat(true), range(given.choices), chunksize=5))
            told = ", ".join(f"{name} {n / given.choices:.1%}" for name, n in found.most_common())
            print(f"{true:10}  {told}", flush=True)


if __name__ == "__main__":
    main()
