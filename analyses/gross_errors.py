"""Gross errors in a six-axis arm: accuracy of the robust fits, and which errors are named.

5 % of the poses carry one: 1 to 50 mm on a coordinate, or 1 degree on a joint. Accuracy is that
of end points predicted for clean poses that took no part, against the truth. Of every fit
also: how often the 95 % intervals of the parameters hold the truth, with the standard error of
that figure, in which a draw counts once.

    python -m analyses.gross_errors [DRAWS]
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

import loopcal as lc
from loopcal.estimation.prediction import predict_outputs
from tests.reference.simulated import MA1400_RANGES, Simulated, arm_at, ma1400

POSES, SHARE = 100, 0.05
LOSSES = ("gaussian", "huber", "student-t")
SIGMAS = 1.959963984540054


@dataclass
class Counts:
    """Of each fit in each draw: mean square of predicted points, share of intervals that held.

    The rest counts gross errors, poses and readings.
    """

    square: dict[str, list[float]]
    held: dict[str, list[float]]
    gross: int = 0
    found: int = 0
    named: int = 0
    alone: int = 0
    good_poses: int = 0
    false_poses: int = 0
    good_readings: int = 0
    false_readings: int = 0

    def rms(self, fit: str) -> float:
        """Rms error of predicted points over all draws [m]."""
        return float(np.sqrt(np.mean(self.square[fit])))

    def coverage(self, fit: str) -> tuple[float, float]:
        """Share of 95 % intervals that held the truth, and its standard error."""
        held = np.array(self.held[fit])
        return float(held.mean()), float(held.std(ddof=1) / np.sqrt(len(held)))


def sds(arm: Simulated) -> dict[str, float]:
    """Encoders of 50 urad, a tracker of 10 um."""
    return {q: 1e-5 if q in arm.truth.outputs else 5e-5 for q in arm.exact}


def with_gross_errors(data: lc.Dataset, seed: int) -> tuple[lc.Dataset, dict[str, str]]:
    """The readings with gross errors, and where they are: pose -> quantity."""
    rng = np.random.default_rng(seed)
    readings = {q: v.copy() for q, v in data.readings.items()}
    points = [q for q in readings if q in "xyz"]
    joints = [q for q in readings if q not in points]
    where: dict[str, str] = {}
    for i in rng.choice(len(data), round(SHARE * len(data)), replace=False):
        sign = rng.choice([-1.0, 1.0])
        if rng.random() < 0.5:
            quantity, size = str(rng.choice(points)), rng.uniform(1e-3, 50e-3)
        else:
            quantity, size = str(rng.choice(joints)), np.radians(1.0)
        readings[quantity][i] += sign * size
        where[data.poses[i]] = quantity
    return lc.Dataset.from_arrays(readings), where


def run(draws: Iterable[int]) -> Counts:
    """Some draws, each a new noise and new gross errors on the same machine."""
    arm = ma1400(POSES)
    low, high = MA1400_RANGES.T
    joints = np.random.default_rng(77).uniform(low, high, (200, 6)).T
    held_out = arm_at(arm.truth, joints)
    start, noise = arm.off(2e-3, 4e-3), lc.Noise(sds(arm))
    clean_fits = {"clean" if loss == "gaussian" else f"clean, {loss}": loss for loss in LOSSES}
    fitted = (*clean_fits, *LOSSES)
    counts = Counts({name: [] for name in fitted}, {name: [] for name in fitted})
    true = np.array(list(arm.values.values()))
    exact = np.array(list(held_out.exact.values()))
    points = np.array([held_out.exact[q] for q in arm.truth.outputs])
    for draw in draws:
        clean = arm.read(sds(arm), seed=1000 + draw)
        data, where = with_gross_errors(clean, seed=5000 + draw)
        fits = {
            name: lc.calibrate(start, clean, noise=noise, loss=loss, method="implicit-loop")
            for name, loss in clean_fits.items()
        }
        fits |= {
            name: lc.calibrate(start, data, noise=noise, loss=name, method="implicit-loop")
            for name in LOSSES
        }
        for name, result in fits.items():
            values = np.array([result.value[n] for n in arm.truth.parameters.names])
            sd = np.sqrt(np.diag(result.covariance))
            counts.held[name].append(float(np.mean(np.abs(values - true) <= SIGMAS * sd)))
            reached = predict_outputs(arm.truth, values, exact, np.empty((0, exact.shape[1])))
            counts.square[name].append(float(np.square(reached - points).sum(axis=0).mean()))
        _count(counts, lc.find_outliers(fits["gaussian"]), where, len(data), len(data.quantities))
    return counts


def _count(
    counts: Counts, outliers: lc.Outliers, where: dict[str, str], poses: int, readings: int
) -> None:
    found = {o.pose: o for o in outliers.found}
    counts.gross += len(where)
    counts.good_poses += poses - len(where)
    counts.good_readings += poses * readings - len(where)
    for pose, quantity in where.items():
        outlier = found.get(pose)
        if outlier is not None:
            counts.found += 1
            counts.named += quantity in (outlier.quantity, *outlier.indistinct)
            counts.alone += quantity == outlier.quantity and not outlier.indistinct
    for pose, outlier in found.items():
        counts.false_poses += pose not in where
        counts.false_readings += outlier.quantity not in (None, where.get(pose))


def main() -> None:
    """Print the table."""
    counts = run(range(int(sys.argv[1]) if len(sys.argv) > 1 else 200))
    print("fit               rms error of points [um]  beside clean   95 % intervals that hold [%]")
    for name in counts.square:
        ratio = counts.rms(name) / counts.rms("clean")
        share, its_error = counts.coverage(name)
        print(
            f"{name:18}{1e6 * counts.rms(name):24.2f}{ratio:14.3f}"
            f"{100 * share:20.2f} +- {100 * its_error:.2f}"
        )
    print(
        f"gross errors: {counts.gross}, pose named {counts.found / counts.gross:.2%}, "
        f"reading among those named {counts.named / counts.gross:.2%}, "
        f"named alone {counts.alone / counts.gross:.2%}"
    )
    print(
        f"good poses named: {counts.false_poses / counts.good_poses:.3%}, "
        f"good readings named: {counts.false_readings / counts.good_readings:.3%}"
    )


if __name__ == "__main__":
    main()
