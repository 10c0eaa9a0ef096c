"""Sds learnt from few poses: do intervals, regions and comparisons hold what they state?

For each case, number of poses and draw two machines alike are calibrated at random poses, with
sds learnt. Counted: parameters within their 95 % interval, by the normal distribution at the learnt
sds (as if these were known) and by Student's t with Kenward and Roger's covariance; joint 95 %
regions of points predicted at new poses; false alarms of `compare` at 5 %, by chi-squared as if
the sds were known, and by F.

    python -m analyses.small_samples [DRAWS [FIRST]]
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

import loopcal as lc
from loopcal.small_samples import LearntCovariance
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.comparison import compare
from loopcal.statistics.intervals import covariance_interval
from loopcal.statistics.predictor import Predictor, predictor

Array = NDArray[np.float64]
How = Literal["group", "each"]
SIGMAS = 1.959963984540054
_APART = 1_000_000
"""Between the seeds of poses and of noise."""
BOX = {"phi2": (0.0, 1.6), "phi3": (0.0, 1.6)}
POSES = (6, 8, 12, 20)


@dataclass(frozen=True)
class Case:
    """The planar arm with encoders of 1 mrad: which sds are learnt, and the tracker's [m]."""

    name: str
    learnt: tuple[tuple[str, How], ...]
    tracker: float = 5e-4

    def __str__(self) -> str:
        return self.name


CASES = (
    Case("encoders, one factor", (("phi?", "group"),)),
    Case("encoders and tracker", (("?P", "group"), ("phi?", "group"))),
    Case("each encoder, tracker", (("?P", "group"), ("phi?", "each"))),
    Case("the same, tracker hidden", (("?P", "group"), ("phi?", "each")), 1e-4),
)


@dataclass(frozen=True)
class Drawn:
    """Shares inside of one draw, and the two p-values of its comparison."""

    normal: float
    student: float
    points_normal: float
    points: float
    p_known: float
    p_value: float


def draw(case: Case, poses: int, seed: int) -> Drawn | None:
    """One draw; None where a fit did not converge."""
    arm = lc.planar_two_link()
    a, b = (calibrated(arm, case, poses, 2 * seed + i) for i in (0, 1))
    if not (a.status.converged and b.status.converged):
        return None
    error = np.array([arm.parameters[n].nominal - a.value[n] for n in a.estimated])
    ends = [covariance_interval(a, n) for n in a.estimated]
    half = np.array([0.5 * (i.high - i.low) for i in ends if i is not None])
    known = SIGMAS * np.sqrt(np.diag(a.learnt_covariance.plain))
    new = lc.random_poses(BOX, 10, seed=seed)
    exact = lc.simulate(arm, new, noise={"*": 0.0}, seed=0).dataset
    seen = lc.predict(a, {q: exact[q] for q in BOX}, noise={"phi?": 0.0})
    off = np.array([exact[q] - v for q, v in seen.outputs.items()]).T
    by_known = lc.predict(_as_known(a), {q: exact[q] for q in BOX}, noise={"phi?": 0.0})
    squares = [
        np.einsum("no,nop,np->n", off, np.linalg.inv(p.covariance), off) for p in (by_known, seen)
    ]
    bare = [
        replace(c, covariance=LearntCovariance.certain(c.covariance.plain))
        for c in (Calibrated.of(a, "A"), Calibrated.of(b, "B"))
    ]
    return Drawn(
        float((np.abs(error) < known).mean()),
        float((np.abs(error) < half).mean()),
        float((squares[0] < by_known.region()).mean()),
        float((squares[1] < seen.region()).mean()),
        compare(bare[0], bare[1], poses=exact).p_value or 0.0,
        compare(a, b, poses=exact).p_value or 0.0,
    )


def calibrated(arm: lc.Mechanism, case: Case, poses: int, seed: int) -> lc.Result:
    """The arm calibrated at random poses of its own."""
    really = lc.Noise({"?P": case.tracker, "phi?": 1e-3})
    at = lc.random_poses(BOX, poses, seed=_APART + seed)
    readings = lc.simulate(arm, at, noise=really, seed=seed).dataset
    learning = lc.Noise(really.entries, estimate=dict(case.learnt))
    return lc.calibrate(arm, readings, noise=learning, start="nominal", method="implicit-loop")


def _as_known(result: lc.Result) -> Predictor:
    found = predictor(result)
    assert found is not None
    return replace(found, covariance=LearntCovariance.certain(found.covariance.plain))


def counted(case: Case, poses: int, seeds: range) -> list[Drawn]:
    """The draws that converged."""
    found = [draw(case, poses, seed) for seed in seeds]
    return [drawn for drawn in found if drawn is not None]


def main(draws: int, first: int = 0) -> None:
    """Print one row per case and number of poses; first: the first draw, a new seed each."""
    print("| learnt | poses | parameters | points | `compare` |")
    print("| --- | --- | --- | --- | --- |")
    for case in CASES:
        for poses in POSES:
            found = counted(case, poses, range(first, first + draws))
            inside = {
                name: 100.0 * np.array([getattr(d, name) for d in found])
                for name in ("normal", "student", "points_normal", "points")
            }
            error = inside["student"].std(ddof=1) / math.sqrt(len(found))
            alarms = [
                100.0 * np.mean([p < 0.05 for p in values])
                for values in ([d.p_known for d in found], [d.p_value for d in found])
            ]
            mean = {name: values.mean() for name, values in inside.items()}
            print(
                f"| {case} | {poses} | {mean['normal']:.1f} → {mean['student']:.1f} ± {error:.1f} "
                f"| {mean['points_normal']:.1f} → {mean['points']:.1f} "
                f"| {alarms[0]:.1f} → {alarms[1]:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3] or ["500"]))
