"""Monte Carlo proof of the learnt sds: mean, stated against actual spread, and tables 5 and 7.

python analyses/variance_components.py [--draws 300]
"""

from __future__ import annotations

import argparse

import numpy as np

import loopcal as lc
from loopcal.estimation.calibrate import calibrate


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
    turns = np.radians(np.arange(0, 100, 10.0))
    phi2, phi3 = (a.ravel() for a in np.meshgrid(turns, turns))
    arm = lc.planar_two_link()
    sds = {"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3} | {bad: 0.1}
    equal = {"?P": 1e-4, "phi?": 1e-3}
    ways = {
        "encoders learnt": lc.Noise(equal, estimate={"phi?": "each"}),
        "all sensors learnt": lc.Noise(equal, estimate={"*": "each"}),
        "true sds": lc.Noise(sds),
    }
    values: dict[str, list[list[float]]] = {way: [] for way in ways}
    for draw in range(draws):
        readings = {"phi2": phi2, "phi3": phi3}
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
    for encoder in ("phi3", "phi2"):
        one_bad_encoder(encoder, min(given.draws, 200))
