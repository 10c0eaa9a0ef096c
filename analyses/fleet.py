"""Machines of one type: bias of the spread, coverage, false alarms and power of "unusual".

    python -m analyses.fleet

Draws the parameters of 3, 5, 10 and 20 machines about a mean, and what calibrations of known
covariance find of them. The spread between machines is 0, 1 and 5 of the sds of a calibration.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from loopcal.companions.life.fleet import Fleet, learn
from loopcal.companions.life.measured_machine import MeasuredMachine
from loopcal.mechanisms.planar import planar_two_link

Array = NDArray[np.float64]
NAMES = ("l2", "l3", "phi30")
SDS = np.array([2e-5, 3e-5, 5e-5])
CORRELATED = np.array([[1.0, -0.8, 0.3], [-0.8, 1.0, -0.2], [0.3, -0.2, 1.0]])
POSES = 40
_ARM = planar_two_link()


def drawn(truth: Array, rng: np.random.Generator) -> tuple[MeasuredMachine, ...]:
    """What calibrations find of machines with these true parameters (R, 3)."""
    machines = []
    for r, true in enumerate(truth):
        sds = SDS * rng.uniform(0.7, 1.4, 3)
        C = CORRELATED * np.outer(sds, sds)
        values = rng.multivariate_normal(true, C)
        yes, no = np.ones(3, dtype=bool), np.zeros(3, dtype=bool)
        machines.append(
            MeasuredMachine(f"m{r}", _ARM, NAMES, values, C, yes, no, POSES, f"data {r}", 3)
        )
    return tuple(machines)


def fleets(
    machines: int, ratio: float, draws: int, *, outlier: Sequence[float] = (), seed: int = 0
) -> tuple[Fleet, ...]:
    """Fleets of so many machines, their spread `ratio` sds; outlier: [spreads] of the first."""
    rng = np.random.default_rng(seed)
    mean, spread = np.array([0.8, 0.6, 0.01]), ratio * SDS
    found = []
    for _ in range(draws):
        truth = mean + spread * rng.standard_normal((machines, 3))
        for i, off in enumerate(outlier):
            truth[0, i] = mean[i] + off * spread[i]
        found.append(learn(drawn(truth, rng)))
    return tuple(found)


def main() -> None:
    """Print the table."""
    print("machines  spread/sd  variance/true  interval holds  false alarms  one off  all off")
    for machines, draws in ((3, 300), (5, 200), (10, 150), (20, 40)):
        for ratio in (0.0, 1.0, 5.0):
            quiet = fleets(machines, ratio, draws)
            true = np.square(ratio * SDS)
            variance = np.mean([[p.spread**2 for p in f.parameters] for f in quiet], axis=0)
            share = float(np.mean(variance / true)) if ratio else np.nan
            holds = np.mean(
                [
                    [p.low <= t <= p.high for p, t in zip(f.parameters, np.sqrt(true), strict=True)]
                    for f in quiet
                ]
            )
            alarms = np.mean([bool(f.unusual) for f in quiet])
            seen = [np.nan, np.nan]
            if ratio:
                off = ((5.0,), (5.0, 5.0, 5.0))
                these = [fleets(machines, ratio, 40, outlier=its, seed=1) for its in off]
                seen = [float(np.mean([f.machines[0].unusual for f in its])) for its in these]
            print(
                f"{machines:8d}  {ratio:9.0f}  {share:13.3f}  {holds:14.3f}  {alarms:12.3f}  "
                f"{seen[0]:7.2f}  {seen[1]:7.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
