"""Monte Carlo proof of the learnt sds: mean, stated against actual spread, bounds, tables 5 and 7.

python -m analyses.variance_components [--draws 300]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import loopcal as lc
from loopcal.estimation.calibrate import calibrate

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SmallNoise:
    """A sensor whose noise these poses hardly see, or do not tell apart from another's."""

    name: str
    arm: lc.Mechanism
    poses: Mapping[str, Array]
    sds: Mapping[str, float]
    start: lc.Noise
    quantity: str

    def __str__(self) -> str:
        return self.name

    def bounds(self, draws: Iterable[int]) -> list[float | None]:
        """The upper bound over the true sd in each draw; None where the sd is sure without."""
        found = []
        for draw in draws:
            noise = lc.Noise(self.sds)
            data = lc.simulate(self.arm, self.poses, noise=noise, seed=draw).dataset
            result = calibrate(self.arm, data, noise=self.start)
            entry = next(e for e in result.noise if self.quantity in e.quantities)
            found.append(None if entry.upper is None else entry.upper / self.sds[self.quantity])
        return found


def _grid() -> dict[str, Array]:
    turns = np.radians(np.arange(0, 100, 10.0))
    phi2, phi3 = (a.ravel() for a in np.meshgrid(turns, turns))
    return {"phi2": phi2, "phi3": phi3}


def _anywhere(mechanism: lc.Mechanism, half: float, poses: int) -> dict[str, Array]:
    driven = [q for q in mechanism.quantities if q not in mechanism.outputs]
    rng = np.random.default_rng(1)
    return {q: rng.uniform(-half, half, poses) for q in driven}


def _small() -> tuple[SmallNoise, ...]:
    planar, arm = lc.planar_two_link(), lc.motoman_ma1400()
    six = {f"theta_{i}": 5e-5 for i in range(1, 7)}
    tracker = dict.fromkeys("xyz", 1e-5)
    two = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3}
    return (
        SmallNoise(
            "planar, grid of 100: an encoder ten times better than the other",
            planar,
            _grid(),
            two | {"phi3": 1e-4},
            lc.Noise({"?P": 1e-4, "phi?": 1e-3}, estimate={"phi?": "each"}),
            "phi3",
        ),
        SmallNoise(
            "planar, 30 poses anywhere: a tracker behind poor encoders, all learnt",
            planar,
            _anywhere(planar, np.pi, 30),
            two | {"phi3": 1e-3},
            lc.Noise({"?P": 2e-4, "phi?": 1e-3}, estimate={"phi?": "each", "?P": "group"}),
            "xP",
        ),
        SmallNoise(
            "MA1400, 60 poses: a tracker of 5 um behind encoders of 50 urad, both learnt",
            arm,
            _anywhere(arm, 1.5, 60),
            six | dict.fromkeys("xyz", 5e-6),
            lc.Noise({"theta_*": 5e-5, "xyz": 1e-5}, estimate={"theta_*": "group", "xyz": "group"}),
            "x",
        ),
        SmallNoise(
            "MA1400, 80 poses: the last encoder at its short lever, all six learnt",
            arm,
            _anywhere(arm, 1.5, 80),
            six | tracker | {"theta_6": 2e-5},
            lc.Noise({"theta_*": 5e-5, "xyz": 1e-5}, estimate={"theta_*": "each"}),
            "theta_6",
        ),
    )


SMALL = _small()


def bound_of(case: SmallNoise, draws: int) -> None:
    """How often the bound holds a noise that is too small to be sure of."""
    all_draws = case.bounds(range(draws))
    bounds = np.array([b for b in all_draws if b is not None])
    held = float(np.mean(bounds >= 1.0))
    print(
        f"{case}\n  bounded in {len(bounds)} of {draws} draws, and held in"
        f" {100 * held:.1f} +- {100 * np.sqrt(held * (1 - held) / len(bounds)):.1f} % of these;"
        f" bound / true: median {np.median(bounds):.2f}"
    )


def six_axis(draws: int) -> None:
    """Joint and tracker sds of an MA1400, 200 poses, from starts off by two to three times."""
    arm, rng = lc.motoman_ma1400(), np.random.default_rng(0)
    true = {"theta_1": 4e-5, "x": 3e-5}
    start = lc.Noise({"theta_*": 1e-4, "xyz": 1e-5}, estimate={"theta_*": "group", "xyz": "group"})
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in true}
    for draw in range(draws):
        q = {f"theta_{i}": rng.uniform(-1.5, 1.5, 200) for i in range(1, 7)}
        noise = lc.Noise({"theta_*": true["theta_1"], "xyz": true["x"]})
        data = lc.simulate(arm, q, noise=noise, seed=draw).dataset
        for entry in calibrate(arm, data, noise=start).noise:
            found[entry.quantities[0]].append((entry.sd, entry.sd_of_sd or 0.0))
    print(f"MA1400, 200 poses, {draws} draws")
    for name, pairs in found.items():
        sds, stated = np.array(pairs).T
        spread = sds.std(ddof=1)
        print(
            f"  {name:8} mean / true {sds.mean() / true[name]:.4f}"
            f" +- {spread / true[name] / np.sqrt(draws):.4f},"
            f" stated / actual spread {np.median(stated) / spread:.3f}"
        )


def one_bad_encoder(bad: str, draws: int) -> None:
    """The seed's tables 5 and 7: errors with equal sds assumed and learnt, beside the true sds."""
    readings, arm = _grid(), lc.planar_two_link()
    sds = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3} | {bad: 0.1}
    equal = {"?P": 1e-4, "phi?": 1e-3}
    ways = {
        "encoders learnt": lc.Noise(equal, estimate={"phi?": "each"}),
        "all sensors learnt": lc.Noise(equal, estimate={"*": "each"}),
        "true sds": lc.Noise(sds),
    }
    values: dict[str, list[list[float]]] = {way: [] for way in ways}
    for draw in range(draws):
        data = lc.simulate(arm, readings, noise=lc.Noise(sds), seed=draw).dataset
        for way, noise in ways.items():
            values[way].append(list(calibrate(arm, data, noise=noise).value.values()))
    true = [parameter.nominal for parameter in arm.parameters]
    rms = {w: np.sqrt(np.square(np.array(v) - true).mean(axis=0)) for w, v in values.items()}
    print(
        f"{bad} a hundred times worse than assumed, {draws} draws: rms error over that of true sds"
    )
    print("  " + " ".join(f"{name:>8}" for name in arm.parameters.names))
    for way in list(ways)[:-1]:
        ratios = " ".join(f"{r:8.3f}" for r in rms[way] / rms["true sds"])
        print(f"  {ratios}   {way}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=300)
    given = parser.parse_args()
    six_axis(given.draws)
    for small in SMALL:
        bound_of(small, given.draws)
    for encoder in ("phi3", "phi2"):
        one_bad_encoder(encoder, min(given.draws, 200))
